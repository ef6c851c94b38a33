"""Configuration of the test cluster."""

import os
from pathlib import Path

from ..ring.processes import run

CONTROLLER = "ctl"
NODES = ("n1", "n2", "n3")
ADDRESSES = {CONTROLLER: "10.213.0.1", "n1": "10.213.0.11", "n2": "10.213.0.12", "n3": "10.213.0.13"}

# Partitions: urgent jobs preempt actors but not the learner.
LEARNERS, ACTORS, URGENT, ALL = "learners", "actors", "urgent", "all"

FOLDER = Path("/etc/slurm")
PATH = FOLDER / "slurm.conf"


def write(folder: Path) -> None:
    """Writes the daemons' configuration over the machine's own files, in this mount namespace only."""
    for name in ("munge", "state", "spool", "logs", *(f"spool/{node}" for node in NODES)):
        (folder / name).mkdir(parents=True, mode=0o755)
    key = folder / "munge" / "key"
    key.write_bytes(os.urandom(128))
    key.chmod(0o600)

    FOLDER.mkdir(exist_ok=True)
    mount_tmpfs(FOLDER)
    # slurmd expects this folder even without a mounted cgroup v1. cgroup.conf tells it not to mount any.
    mount_tmpfs(Path("/sys/fs/cgroup"))
    PATH.write_text(slurm_conf(folder))
    (FOLDER / "cgroup.conf").write_text("CgroupPlugin=cgroup/v1\nCgroupAutomount=no\n")
    # A dummy GPU that jobs can request. Slurm sets CUDA_VISIBLE_DEVICES for them.
    (FOLDER / "gres.conf").write_text("Name=gpu File=/dev/null\n")

    hosts = folder / "hosts"
    lines = [f"{address} {name}\n" for name, address in ADDRESSES.items()]
    hosts.write_text("127.0.0.1 localhost\n" + "".join(lines))
    run(["mount", "--bind", hosts, "/etc/hosts"])


def slurm_conf(folder: Path) -> str:
    """Returns the text of `slurm.conf`.

    Slurm counts the CPUs that nodes claim to have, and binds nothing. A requeued job waits as long as a credential
    lives: here 5 s, by default 120 s.
    """
    nodes, addresses = ",".join(NODES), ",".join(ADDRESSES[node] for node in NODES)
    return f"""
ClusterName=test
SlurmctldHost={CONTROLLER}({ADDRESSES[CONTROLLER]})
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge/socket,cred_expire=5
CredType=cred/munge
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool/%n
SlurmctldLogFile={folder}/logs/slurmctld.log
SlurmdLogFile={folder}/logs/%n.log
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd-%n.pid
SlurmdParameters=config_overrides
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerType=sched/backfill
SchedulerParameters=sched_interval=2,bf_interval=2,sched_min_interval=100000,batch_sched_delay=1
PreemptType=preempt/partition_prio
PreemptMode=REQUEUE
JobRequeue=1
ReturnToService=2
MessageTimeout=5
SlurmctldTimeout=60
SlurmdTimeout=10
KillWait=120
GresTypes=gpu
NodeName={nodes} NodeAddr={addresses} CPUs=3 RealMemory=16000 Gres=gpu:1 State=UNKNOWN
PartitionName={ALL} Nodes={nodes} Default=YES PriorityTier=1 PreemptMode=OFF
PartitionName={LEARNERS} Nodes={nodes} PriorityTier=10 PreemptMode=OFF
PartitionName={ACTORS} Nodes={nodes} PriorityTier=1 PreemptMode=REQUEUE
PartitionName={URGENT} Nodes={nodes} PriorityTier=20 PreemptMode=OFF
"""


def mount_tmpfs(folder: Path) -> None:
    """Mounts an empty file system over `folder`."""
    run(["mount", "-t", "tmpfs", "tmpfs", folder])

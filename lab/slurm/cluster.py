"""A Slurm cluster on one machine: a controller and three nodes that share only files and users.

Each node has its own namespaces for network, processes, host name, and mounts, so it can be cut off or lose power like
a real machine. Nothing is visible outside: when the first process exits, for whatever reason, the kernel kills all
others and removes interfaces and mounts.
"""

import subprocess
from pathlib import Path

from ..ring.checks import require, until
from ..ring.processes import Process, attempt, run
from . import conf

# Program -> Debian package that provides it.
PROGRAMS = {
    "munged": "munge",
    **dict.fromkeys(("slurmctld", "slurmd", "sbatch", "scontrol"), "slurm-wlm"),
    **dict.fromkeys(("setpriv", "unshare", "mount"), "util-linux"),
    "ip": "iproute2",
    "hostname": "hostname",
}

# The init process of a node. It waits for its network. It is a shell because the init of a namespace adopts orphans,
# and slurmd would not reap them.
NODE_INIT = r"""
read -r address
hostname "$1"
ip link set lo up
ip address add "$address/24" dev eth0
ip link set eth0 up
slurmd -D &
wait $!
"""


def isolate(command: list[str]) -> list[str]:
    """Returns a command that runs `command` in its own namespaces. All its processes end with it."""
    flags = ["--net", "--mount", "--uts", "--ipc", "--pid", "--fork", "--kill-child", "--mount-proc"]
    return ["unshare", *flags, *command]


class Cluster:
    """A running cluster that writes all its files to `folder`."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._daemons: dict[str, Process] = {}

    def start(self) -> None:
        """Starts all daemons and waits until all nodes are idle."""
        conf.write(self._folder)
        ip("link set lo up")
        ip("link add br0 type bridge")
        ip(f"address add {conf.ADDRESSES[conf.CONTROLLER]}/24 dev br0")
        ip("link set br0 up")
        run(["hostname", conf.CONTROLLER])
        munge = self._folder / "munge"
        files = [f"--key-file={munge}/key", f"--pid-file={munge}/pid", f"--log-file={munge}/log", f"--seed-file={munge}/seed"]
        # --force skips the permission checks of folders, which may fail where a test runs.
        self._start("munged", ["munged", "--foreground", "--force", f"--socket={munge}/socket", *files])
        until("munged listens", 20, (munge / "socket").exists)
        self._start("slurmctld", ["slurmctld", "-D", "-c", "-f", str(conf.PATH)])
        for node in conf.NODES:
            self.power_on(node)
        until("the nodes are idle", 60, lambda: states() == ["idle"] * len(conf.NODES), self._check)

    def power_on(self, node: str) -> None:
        """Starts a node, which joins the cluster automatically."""
        process = self._start(node, isolate(["bash", "-euc", NODE_INIT, "node", node]), stdin=subprocess.PIPE)
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        [init] = until(f"{node} has namespaces", 10, lambda: children.read_text().split())
        ip(f"link add {bridge_port(node)} type veth peer name eth0 netns {init}")
        ip(f"link set {bridge_port(node)} master br0 up")
        process.tell(conf.ADDRESSES[node])

    def power_off(self, node: str) -> None:
        """Kills every process of the node at once, like a power failure."""
        self._daemons.pop(node).kill()
        links = Path("/proc/self/net/dev")
        until(f"the link of {node} is gone", 20, lambda: f"{bridge_port(node)}:" not in links.read_text())

    def cut(self, node: str) -> None:
        """Takes the node's link down. Its processes keep running."""
        ip(f"link set {bridge_port(node)} down")

    def mend(self, node: str) -> None:
        """Brings the node's link back up."""
        ip(f"link set {bridge_port(node)} up")

    def stop(self) -> None:
        """Kills all processes of the cluster, the nodes first."""
        for daemon in reversed(self._daemons.values()):
            daemon.kill()

    def _start(self, name: str, command: list[str], stdin: int = subprocess.DEVNULL) -> Process:
        self._daemons[name] = Process(command, self._folder / "logs" / f"{name}.out", stdin=stdin)
        return self._daemons[name]

    def _check(self) -> None:
        for name, daemon in self._daemons.items():
            require(daemon.code is None, f"{name} ended with {daemon.code}: see {daemon.log}")


def ip(arguments: str) -> None:
    run(["ip", *arguments.split()])


def bridge_port(node: str) -> str:
    return f"to-{node}"


def states() -> list[str]:
    """Returns the states of the nodes in order, such as `idle`, `alloc`, or `down*`."""
    return attempt(["sinfo", "-h", "-N", "-p", conf.ALL, "-o", "%t"]).stdout.split()

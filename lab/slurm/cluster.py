"""A Slurm cluster on one machine: a controller and three nodes that share only files and users.

Each node has its own namespaces for network, processes, host name, and mounts, so it can be cut off or lose power like
a real machine. Nothing is visible outside: when the first process exits, for whatever reason, the kernel kills all
others and removes interfaces and mounts.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

import conf
from wait import wait_for

DAEMONS = ("munged", "slurmctld", "slurmd")


def missing_programs() -> list[str]:
    """Returns the programs that the cluster needs but this machine lacks."""
    path = os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", "/sbin"])
    wanted = (*DAEMONS, "sbatch", "scontrol", "setpriv", "unshare", "ip", "mount", "hostname")
    return [program for program in wanted if shutil.which(program, path=path) is None]


def isolate(command: list[str]) -> list[str]:
    """Returns a command that runs `command` in its own namespaces. All its processes end with it."""
    flags = ["--net", "--mount", "--uts", "--ipc", "--pid", "--fork", "--kill-child", "--mount-proc"]
    return ["unshare", *flags, *command]


@dataclass
class Daemon:
    """A cluster process and its log."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path

    def check(self) -> None:
        """Raises RuntimeError if the process has exited."""
        if self.process.poll() is not None:
            raise RuntimeError(f"{self.name} ended with {self.process.returncode}: see {self.log}")

    def end(self) -> None:
        """Kills the process and everything in its namespaces."""
        self.process.kill()
        self.process.wait()


@dataclass
class Cluster:
    """A running cluster that writes all its files to `folder`."""

    folder: Path
    munged: Daemon | None = None
    controller: Daemon | None = None
    nodes: dict[str, Daemon] = field(default_factory=dict)

    def start(self) -> None:
        """Starts all daemons and waits until all nodes are idle."""
        self._prepare()
        self.munged = self._daemon("munged", munged_command(self.folder))
        socket = conf.munge_socket(self.folder)
        wait_for("munged listens", socket.exists, 20)
        self.controller = self._daemon("slurmctld", ["slurmctld", "-D", "-c", "-f", str(conf.PATH)])
        for node in conf.NODES:
            self.power_on(node)
        wait_for("the nodes are idle", lambda: states() == ["idle"] * len(conf.NODES), 60, self._check)

    def power_on(self, node: str) -> None:
        """Starts a node, which joins the cluster automatically."""
        daemon = self._daemon(node, isolate(["bash", "-euc", NODE_INIT, "node", node]), stdin=True)
        self.nodes[node] = daemon
        init = wait_for(f"{node} has namespaces", lambda: child_of(daemon.process.pid), 10)
        inner, outer = "eth0", bridge_port(node)
        ip("link", "add", outer, "type", "veth", "peer", "name", inner, "netns", str(init))
        ip("link", "set", outer, "master", "br0", "up")
        assert daemon.process.stdin is not None
        daemon.process.stdin.write(f"{conf.ADDRESSES[node]}\n".encode())
        daemon.process.stdin.close()

    def power_off(self, node: str) -> None:
        """Kills every process of the node at once, like a power failure."""
        self.nodes.pop(node).end()
        wait_for(f"the link of {node} is gone", lambda: not link_exists(bridge_port(node)), 20)

    def cut(self, node: str) -> None:
        """Takes the node's link down. Its processes keep running."""
        ip("link", "set", bridge_port(node), "down")

    def mend(self, node: str) -> None:
        """Brings the node's link back up."""
        ip("link", "set", bridge_port(node), "up")

    def stop(self) -> None:
        """Kills all processes of the cluster."""
        for daemon in [*self.nodes.values(), self.controller, self.munged]:
            if daemon is not None:
                daemon.end()

    def _prepare(self) -> None:
        conf.write(self.folder)
        ip("link", "set", "lo", "up")
        ip("link", "add", "br0", "type", "bridge")
        ip("address", "add", f"{conf.ADDRESSES[conf.CONTROLLER]}/24", "dev", "br0")
        ip("link", "set", "br0", "up")
        subprocess.run(["hostname", conf.CONTROLLER], check=True)

    def _daemon(self, name: str, command: list[str], stdin: bool = False) -> Daemon:
        log = self.folder / "logs" / f"{name}.out"
        with log.open("ab") as out:
            source = subprocess.PIPE if stdin else subprocess.DEVNULL
            process = subprocess.Popen(command, stdin=source, stdout=out, stderr=subprocess.STDOUT)
        return Daemon(name, process, log)

    def _check(self) -> None:
        for daemon in [*self.nodes.values(), self.controller, self.munged]:
            if daemon is not None:
                daemon.check()


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


def munged_command(folder: Path) -> list[str]:
    """Returns the `munged` command with its files in `folder`.

    --force skips the permission checks of folders, which may fail where a test runs.
    """
    munge = folder / "munge"
    return [
        "munged", "--foreground", "--force", f"--key-file={munge / 'key'}", f"--socket={conf.munge_socket(folder)}",
        f"--pid-file={munge / 'pid'}", f"--log-file={munge / 'log'}", f"--seed-file={munge / 'seed'}",
    ]  # fmt: skip


def ip(*args: str) -> None:
    """Runs `ip`."""
    subprocess.run(["ip", *args], check=True)


def link_exists(name: str) -> bool:
    """Returns whether an interface of this name exists."""
    return Path("/proc/self/net/dev").read_text(encoding="utf-8").find(f"{name}:") >= 0


def bridge_port(node: str) -> str:
    """Returns the name of the controller's end of a node's link."""
    return f"to-{node}"


def child_of(pid: int) -> int | None:
    """Returns the only child of a process, or None."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
    return int(children[0]) if children else None


def states() -> list[str]:
    """Returns the states of the nodes in order, such as `idle`, `alloc`, or `down*`."""
    listed = subprocess.run(["sinfo", "-h", "-N", "-p", conf.ALL, "-o", "%t"], capture_output=True, text=True, check=False)
    return listed.stdout.split()

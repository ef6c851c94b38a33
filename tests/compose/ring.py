"""A run of deploy/compose.yaml under a project name of its own."""

import json
import os
import re
import signal
import socket
import subprocess
import tarfile
import time
import urllib.request
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

from checks import Failed, require, until
from image import ROOT
from shell import run

PRESET = "near-goal"

# More steps than a test can make.
ENDLESS = 1_000_000_000


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """A port that was free a moment ago. Docker's own choice changes whenever a container is started again."""
    with socket.socket(type=kind) as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


class Ring:
    """Services of one Compose project, by the names in deploy/compose.yaml."""

    def __init__(self, compose: Sequence[str], project: str, image: str) -> None:
        self.project = project
        self.image = image
        self.page_port = free_port()
        self.bus_port = free_port(socket.SOCK_DGRAM)
        self._compose = [
            *compose,
            "--project-name",
            project,
            "--file",
            str(ROOT / "deploy/compose.yaml"),
            # What a user would do for settings that have no variable.
            "--file",
            str(Path(__file__).with_name("quick.yaml")),
        ]

    def compose(self, *arguments: str, steps: int = ENDLESS, seconds: float = 180) -> str:
        """Runs a command of Compose."""
        return run([*self._compose, *arguments], env=self._variables(steps), seconds=seconds)

    def up(self, *arguments: str, steps: int = ENDLESS) -> None:
        """Starts what is not running, or changes what is."""
        self.compose("up", "--detach", "--no-build", *arguments, steps=steps)

    def down(self, *arguments: str) -> None:
        """Stops and removes containers and networks; volumes stay without `--volumes`."""
        self.compose("down", "--remove-orphans", *arguments)

    def containers(self, service: str, all_of_them: bool = False) -> list[str]:
        """Ids of a service's containers, of those that run unless `all_of_them`."""
        command = ["docker", "ps", "--quiet", "--no-trunc"]
        command += ["--filter", f"label=com.docker.compose.project={self.project}"]
        command += ["--filter", f"label=com.docker.compose.service={service}"]
        # A container that `compose run` made is no part of the service.
        command += ["--filter", "label=com.docker.compose.oneoff=False"]
        return run(command + ["--all"] * all_of_them).split()

    def container(self, service: str) -> str:
        """The one container of a service, whether it runs or not."""
        found = self.containers(service, all_of_them=True)
        require(len(found) == 1, f"{service} has {len(found)} containers, not one")
        return found[0]

    def wait_healthy(self, services: Mapping[str, int], seconds: float = 90) -> None:
        """Waits until each service has so many containers and Docker calls all of them healthy."""
        for service, n_containers in services.items():

            def states(service: str = service, n_containers: int = n_containers) -> bool:
                seen = [inspect(container)["State"]["Health"]["Status"] for container in self.containers(service)]
                if seen != ["healthy"] * n_containers:
                    raise Failed(f"{service} is {seen}")
                return True

            until(f"{n_containers} healthy of {service}", seconds, states)

    def page(self, path: str, host: str | None = None) -> str:
        """What the evaluator's page answers, asked by the name `host`."""
        request = urllib.request.Request(f"http://127.0.0.1:{self.page_port}{path}")
        if host:
            request.add_header("Host", host)
        with urllib.request.urlopen(request, timeout=5) as answer:
            return str(answer.read().decode())

    def metric(self, name: str, labels: str = "") -> float:
        """One value of the page's metrics, by its name and its labels beside the run's."""
        pattern = re.compile(rf'{name}{{run="[^"]*"{"," if labels else ""}{re.escape(labels)}}} (\S+)')
        for line in self.page("/metrics").splitlines():
            if found := pattern.fullmatch(line):
                return float(found[1])
        raise Failed(f"the page has no {name} of {labels or 'its run'} yet")

    def name(self) -> str:
        """Name of the run, as the page tells it."""
        return str(json.loads(self.page("/api/about"))["run"])

    def n_alive(self, role: str) -> int:
        """Members of the run, as the page knows them."""
        return int(self.metric("lodestone_alive_processes", f'role="{role}"'))

    def n_steps(self) -> int:
        """Environment steps that the learner has consumed, as the page knows them."""
        return int(self.metric("lodestone_learner_env_steps_total"))

    def wait_steps(self, above: int, seconds: float = 90) -> int:
        """Waits until the learner has consumed more than `above` steps; returns how many."""

        def steps() -> int:
            seen = self.n_steps()
            if seen <= above:
                raise Failed(f"{seen} steps, {self.n_alive('learner')} learners and {self.n_alive('actor')} actors")
            return seen

        return until(f"more than {above} steps", seconds, steps)

    def keeps_learning(self, seconds: float = 90) -> int:
        """Waits until the learner has consumed more than the page knows of now; returns how many steps."""
        seen = until("steps on the page", seconds, self.n_steps)
        return self.wait_steps(seen, seconds)

    def wait_alive(self, role: str, n_alive: int, seconds: float = 90) -> None:
        """Waits until the page knows of so many members of a role."""

        def seen() -> bool:
            if self.n_alive(role) != n_alive:
                raise Failed(f"{self.n_alive(role)} are alive")
            return True

        until(f"{n_alive} alive of {role}", seconds, seen)

    def run_folder(self) -> Path:
        """The folder of the run in its volume, on this machine's disk."""
        mountpoint = run(["docker", "volume", "inspect", "--format", "{{.Mountpoint}}", f"{self.project}_runs"])
        return Path(mountpoint.strip()) / PRESET

    def copy(self, service: str, path: str, into: Path) -> None:
        """Copies a file or folder out of a container, running or not."""
        packed = _tar(self.container(service), path)
        with tarfile.open(fileobj=BytesIO(packed)) as files:
            files.extractall(into, filter="data")

    def logs(self, lines: int = 6) -> str:
        """The last lines of all containers."""
        return self.compose("logs", "--no-color", f"--tail={lines}")

    def _variables(self, steps: int) -> dict[str, str]:
        return {
            **{name: value for name, value in os.environ.items() if not name.startswith("LODESTONE_")},
            "ACTORS": "2",
            "BUS_PORT": str(self.bus_port),
            "LODESTONE_IMAGE": self.image,
            "LODESTONE_PRESET": PRESET,
            "LODESTONE_SEED": "1",
            "LODESTONE_STEPS": str(steps),
            "PAGE_PORT": str(self.page_port),
        }


def inspect(name: str) -> dict[str, Any]:
    """What Docker knows of a container or an image."""
    [about] = json.loads(run(["docker", "inspect", name]))
    found: dict[str, Any] = about
    return found


def crash(container: str) -> int:
    """Kills the program in a container and not the container, and waits until Docker has started it again.

    `docker kill` counts as a person's wish, after which no restart policy applies. Returns how often it was started again.
    """
    before = inspect(container)
    for process in _children(before["State"]["Pid"]):
        os.kill(process, signal.SIGKILL)

    def restarted() -> int:
        now = inspect(container)
        return now["RestartCount"] if now["RestartCount"] > before["RestartCount"] and now["State"]["Running"] else 0

    return until("the container starts again", 30, restarted)


def exit_code(container: str, seconds: float = 90) -> int:
    """Waits until a container has ended for good."""

    def ended() -> bool:
        return bool(inspect(container)["State"]["Status"] == "exited")

    until("the container ends", seconds, ended)
    return int(inspect(container)["State"]["ExitCode"])


def stays_ended(container: str, seconds: float) -> None:
    """Fails if a container is started again within so many seconds."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        seen = inspect(container)
        require(seen["State"]["Status"] == "exited" and seen["RestartCount"] == 0, "it was started again")
        time.sleep(0.5)


def _children(init: int) -> list[int]:
    """Processes that the container's init has started."""
    return [int(pid) for pid in Path(f"/proc/{init}/task/{init}/children").read_text().split()]


def _tar(container: str, path: str) -> bytes:
    copied = subprocess.run(["docker", "cp", f"{container}:{path}", "-"], capture_output=True, timeout=60, check=False)
    require(copied.returncode == 0, f"docker cp {path}: {copied.stderr.decode(errors='replace').strip()}")
    return copied.stdout

"""A run of deploy/compose.yaml under its own project name."""

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

# More steps than a test can run.
ENDLESS = 1_000_000_000


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """Returns a port that was free a moment ago. A port chosen by Docker would change when a container restarts."""
    with socket.socket(type=kind) as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


class Ring:
    """The services of one Compose project, named as in deploy/compose.yaml."""

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
            # A second file, as a user would add for settings that have no variable.
            "--file",
            str(Path(__file__).with_name("quick.yaml")),
        ]

    def compose(self, *arguments: str, steps: int = ENDLESS, seconds: float = 180) -> str:
        """Runs a Compose command and returns its output."""
        return run([*self._compose, *arguments], env=self._variables(steps), seconds=seconds)

    def up(self, *arguments: str, steps: int = ENDLESS) -> None:
        """Starts services that are not running and updates those that are."""
        self.compose("up", "--detach", "--no-build", *arguments, steps=steps)

    def down(self, *arguments: str) -> None:
        """Stops and removes containers and networks. Volumes stay unless `--volumes` is given."""
        self.compose("down", "--remove-orphans", *arguments)

    def containers(self, service: str, all_of_them: bool = False) -> list[str]:
        """Returns the ids of a service's running containers, or of all its containers with `all_of_them`."""
        command = ["docker", "ps", "--quiet", "--no-trunc"]
        command += ["--filter", f"label=com.docker.compose.project={self.project}"]
        command += ["--filter", f"label=com.docker.compose.service={service}"]
        # Exclude containers created by `compose run`, which are not part of the service.
        command += ["--filter", "label=com.docker.compose.oneoff=False"]
        return run(command + ["--all"] * all_of_them).split()

    def container(self, service: str) -> str:
        """Returns the only container of a service, running or not."""
        found = self.containers(service, all_of_them=True)
        require(len(found) == 1, f"{service} has {len(found)} containers, not one")
        return found[0]

    def wait_healthy(self, services: Mapping[str, int], seconds: float = 90) -> None:
        """Waits until each service has the given number of containers and Docker reports all of them healthy."""
        for service, n_containers in services.items():

            def states(service: str = service, n_containers: int = n_containers) -> bool:
                seen = [inspect(container)["State"]["Health"]["Status"] for container in self.containers(service)]
                if seen != ["healthy"] * n_containers:
                    raise Failed(f"{service} is {seen}")
                return True

            until(f"{n_containers} healthy of {service}", seconds, states)

    def page(self, path: str, host: str | None = None) -> str:
        """Fetches `path` from the evaluator's page, with `host` as the Host header."""
        request = urllib.request.Request(f"http://127.0.0.1:{self.page_port}{path}")
        if host:
            request.add_header("Host", host)
        with urllib.request.urlopen(request, timeout=5) as answer:
            return str(answer.read().decode())

    def metric(self, name: str, labels: str = "") -> float:
        """Returns one of the page's metrics by name and by its labels other than `run`."""
        pattern = re.compile(rf'{name}{{run="[^"]*"{"," if labels else ""}{re.escape(labels)}}} (\S+)')
        for line in self.page("/metrics").splitlines():
            if found := pattern.fullmatch(line):
                return float(found[1])
        raise Failed(f"the page has no {name} of {labels or 'its run'} yet")

    def name(self) -> str:
        """Returns the run's name as the page reports it."""
        return str(json.loads(self.page("/api/about"))["run"])

    def n_alive(self, role: str) -> int:
        """Returns the number of live processes of a role as the page reports it."""
        return int(self.metric("lodestone_alive_processes", f'role="{role}"'))

    def n_steps(self) -> int:
        """Returns the environment steps that the learner has consumed as the page reports them."""
        return int(self.metric("lodestone_learner_env_steps_total"))

    def wait_steps(self, above: int, seconds: float = 90) -> int:
        """Waits until the learner has consumed more than `above` steps and returns the number."""

        def steps() -> int:
            seen = self.n_steps()
            if seen <= above:
                raise Failed(f"{seen} steps, {self.n_alive('learner')} learners and {self.n_alive('actor')} actors")
            return seen

        return until(f"more than {above} steps", seconds, steps)

    def keeps_learning(self, seconds: float = 90) -> int:
        """Waits until the learner has consumed more steps than the page reports now and returns the number."""
        seen = until("steps on the page", seconds, self.n_steps)
        return self.wait_steps(seen, seconds)

    def wait_alive(self, role: str, n_alive: int, seconds: float = 90) -> None:
        """Waits until the page reports `n_alive` live processes of a role."""

        def seen() -> bool:
            if self.n_alive(role) != n_alive:
                raise Failed(f"{self.n_alive(role)} are alive")
            return True

        until(f"{n_alive} alive of {role}", seconds, seen)

    def run_folder(self) -> Path:
        """Returns the run folder inside its volume, as a path on this machine."""
        mountpoint = run(["docker", "volume", "inspect", "--format", "{{.Mountpoint}}", f"{self.project}_runs"])
        return Path(mountpoint.strip()) / PRESET

    def copy(self, service: str, path: str, into: Path) -> None:
        """Copies a file or folder out of a container, running or not."""
        packed = _tar(self.container(service), path)
        with tarfile.open(fileobj=BytesIO(packed)) as files:
            files.extractall(into, filter="data")

    def logs(self, lines: int = 6) -> str:
        """Returns the last log lines of all containers."""
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
    """Returns Docker's description of a container or an image."""
    [about] = json.loads(run(["docker", "inspect", name]))
    found: dict[str, Any] = about
    return found


def crash(container: str) -> int:
    """Kills the program inside a container and waits until Docker restarts the container.

    `docker kill` counts as a manual stop, after which no restart policy applies. Returns the number of restarts.
    """
    before = inspect(container)
    for process in _children(before["State"]["Pid"]):
        os.kill(process, signal.SIGKILL)

    def restarted() -> int:
        now = inspect(container)
        return now["RestartCount"] if now["RestartCount"] > before["RestartCount"] and now["State"]["Running"] else 0

    return until("the container starts again", 30, restarted)


def exit_code(container: str, seconds: float = 90) -> int:
    """Waits until a container has exited and returns its exit code."""

    def ended() -> bool:
        return bool(inspect(container)["State"]["Status"] == "exited")

    until("the container ends", seconds, ended)
    return int(inspect(container)["State"]["ExitCode"])


def stays_ended(container: str, seconds: float) -> None:
    """Fails if a container is restarted within `seconds`."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        seen = inspect(container)
        require(seen["State"]["Status"] == "exited" and seen["RestartCount"] == 0, "it was started again")
        time.sleep(0.5)


def _children(init: int) -> list[int]:
    """Returns the processes started by the container's init."""
    return [int(pid) for pid in Path(f"/proc/{init}/task/{init}/children").read_text().split()]


def _tar(container: str, path: str) -> bytes:
    copied = subprocess.run(["docker", "cp", f"{container}:{path}", "-"], capture_output=True, timeout=60, check=False)
    require(copied.returncode == 0, f"docker cp {path}: {copied.stderr.decode(errors='replace').strip()}")
    return copied.stdout

"""A run of deploy/compose.yaml under its own project name."""

import json
import os
import re
import signal
import socket
import time
import urllib.request
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from ..ring.checks import Failed, require, until
from ..ring.processes import ENDLESS, ROOT, free_port, plain_environment, run

PRESET = "smoke"

# While containers start and stop, requests are refused, and that is no failure yet.
wait = partial(until, forgive=(Exception,))


class Ring:
    """The services of one Compose project, named as in deploy/compose.yaml."""

    def __init__(self, compose: Sequence[str], project: str, image: str) -> None:
        self.project = project
        self.image = image
        # A port chosen by Docker would change when a container restarts.
        self.page_port = free_port()
        self.bus_port = free_port(socket.SOCK_DGRAM)
        # A second file, as a user would add for settings that have no variable.
        files = ["--file", str(ROOT / "deploy/compose.yaml"), "--file", str(Path(__file__).with_name("quick.yaml"))]
        self._compose = [*compose, "--project-name", project, *files]

    def compose(self, *arguments: str, steps: int = ENDLESS) -> str:
        """Runs a Compose command and returns its output."""
        variables = {
            **plain_environment(),
            "ACTORS": "2",
            "BUS_PORT": str(self.bus_port),
            "LODESTONE_IMAGE": self.image,
            "LODESTONE_PRESET": PRESET,
            "LODESTONE_SEED": "1",
            "LODESTONE_STEPS": str(steps),
            "PAGE_PORT": str(self.page_port),
        }
        return run([*self._compose, *arguments], env=variables, seconds=180)

    def up(self, *arguments: str, steps: int = ENDLESS) -> None:
        self.compose("up", "--detach", "--no-build", *arguments, steps=steps)

    def down(self, *arguments: str) -> None:
        """Stops and removes containers and networks. Volumes stay unless `--volumes` is given."""
        self.compose("down", "--remove-orphans", *arguments)

    def containers(self, service: str, *options: str) -> list[str]:
        """Returns the ids of a service's running containers, or with `--all` of all its containers."""
        # Exclude containers created by `compose run`, which are not part of the service.
        labels = (f"project={self.project}", f"service={service}", "oneoff=False")
        filters = [word for label in labels for word in ("--filter", f"label=com.docker.compose.{label}")]
        return run(["docker", "ps", "--quiet", "--no-trunc", *filters, *options]).split()

    def container(self, service: str) -> str:
        found = self.containers(service, "--all")
        require(len(found) == 1, f"{service} has {len(found)} containers, not one")
        return found[0]

    def wait_healthy(self, services: Mapping[str, int]) -> None:
        """Waits until each service has the given number of containers and Docker reports all of them healthy."""
        for service, n_containers in services.items():

            def healthy(service: str = service, n_containers: int = n_containers) -> bool:
                seen = [inspect(container)["State"]["Health"]["Status"] for container in self.containers(service)]
                require(seen == ["healthy"] * n_containers, f"{service} is {seen}")
                return True

            wait(f"{n_containers} healthy of {service}", 90, healthy)

    def page(self, path: str, host: str | None = None) -> str:
        """Fetches `path` from the evaluator's page, with `host` as the Host header."""
        request = urllib.request.Request(f"http://127.0.0.1:{self.page_port}{path}", headers={"Host": host} if host else {})
        with urllib.request.urlopen(request, timeout=5) as answer:
            return str(answer.read().decode())

    def metric(self, name: str, labels: str = "") -> int:
        """Returns one of the page's metrics by name and by its labels other than `run`."""
        pattern = rf'^{name}{{run="[^"]*"{"," if labels else ""}{re.escape(labels)}}} (\S+)$'
        found = re.search(pattern, self.page("/metrics"), re.MULTILINE)
        require(found, f"the page has no {name} of {labels or 'its run'} yet")
        return int(float(found[1])) if found else 0

    def name(self) -> str:
        return str(json.loads(self.page("/api/about"))["run"])

    def n_alive(self, role: str) -> int:
        return self.metric("lodestone_alive_processes", f'role="{role}"')

    def n_steps(self) -> int:
        return self.metric("lodestone_learner_env_steps_total")

    def wait_steps(self, above: int) -> int:
        """Waits until the learner has consumed more than `above` steps and returns the number."""

        def steps() -> int:
            seen = self.n_steps()
            require(seen > above, f"{seen} steps, {self.n_alive('learner')} learners and {self.n_alive('actor')} actors")
            return seen

        return wait(f"more than {above} steps", 90, steps)

    def keeps_learning(self) -> int:
        """Waits until the learner has consumed more steps than the page reports now and returns the number."""
        return self.wait_steps(wait("steps on the page", 90, self.n_steps))

    def wait_alive(self, role: str, n_alive: int) -> None:
        """Waits until the page reports `n_alive` live processes of a role."""

        def seen() -> bool:
            require(self.n_alive(role) == n_alive, f"{self.n_alive(role)} are alive")
            return True

        wait(f"{n_alive} alive of {role}", 90, seen)

    def run_folder(self) -> Path:
        """Returns the run folder inside its volume, as a path on this machine."""
        mountpoint = run(["docker", "volume", "inspect", "--format", "{{.Mountpoint}}", f"{self.project}_runs"])
        return Path(mountpoint.strip()) / PRESET


def inspect(name: str) -> dict[str, Any]:
    [about] = json.loads(run(["docker", "inspect", name]))
    found: dict[str, Any] = about
    return found


def crash(container: str) -> int:
    """Kills the program inside a container and waits until Docker restarts the container.

    `docker kill` counts as a manual stop, after which no restart policy applies. Returns the number of restarts.
    """
    before = inspect(container)
    init = before["State"]["Pid"]
    for process in Path(f"/proc/{init}/task/{init}/children").read_text().split():
        os.kill(int(process), signal.SIGKILL)

    def restarted() -> int:
        now = inspect(container)
        return now["RestartCount"] if now["RestartCount"] > before["RestartCount"] and now["State"]["Running"] else 0

    return wait("the container starts again", 30, restarted)


def exit_code(container: str) -> int:
    """Waits until a container has exited and returns its exit code."""
    wait("the container ends", 90, lambda: inspect(container)["State"]["Status"] == "exited")
    return int(inspect(container)["State"]["ExitCode"])


def stays_ended(container: str, seconds: float) -> None:
    """Fails if a container is restarted within `seconds`."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        seen = inspect(container)
        if seen["State"]["Status"] != "exited" or seen["RestartCount"]:
            raise Failed("it was started again")
        time.sleep(0.5)

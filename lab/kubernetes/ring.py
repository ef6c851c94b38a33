"""Runs the pods of a run as local processes, with the rendered arguments, variables, Secrets, and probes.

Does not reproduce the cluster's network (everything is on loopback), users, or read-only root.
"""

import copy
import os
import re
import signal
import socket
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import keys
import settings
from manifests import Object, Workload, containers, of_kind
from pods import PROBES, quantity
from report import Report

# The smallest task that needs the whole ring.
RUN = {"LODESTONE_PRESET": "near-goal", "LODESTONE_RUN": "near-goal"}
DEADLINE_S = 180.0
PERIOD_S = 0.5
FOLDER = re.compile(r"(?<![\w./])/(keys|tmp|runs)(?=/|$)")
PAGE = re.compile(r"http://127\.0\.0\.1:\d+")


def make_keys(binary: Path, folder: Path) -> None:
    """Creates keys as described in docs/kubernetes.md."""
    done = settings.call(binary, ["keys", "new", str(folder), "--host", "router"], {})
    if done.returncode != 0:
        raise SystemExit(f"`lodestone keys new` failed: {done.stderr.strip()}")


def free_port() -> int:
    """Returns a free port. The router cannot choose one itself, because its clients must know the port beforehand."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


def mount(secret: Object, folder: Path) -> None:
    """Lays out the files like the kubelet: behind two symbolic links, readable by owner and group."""
    version = folder / "..2026"
    version.mkdir(parents=True)
    (folder / "..data").symlink_to(version.name)
    for name, content in keys.files(secret).items():
        (version / name).write_bytes(content)
        (version / name).chmod(0o440)
        (folder / name).symlink_to(f"..data/{name}")


@dataclass
class Pod:
    """One pod, which can be stopped and restarted with the same volumes."""

    binary: Path
    workload: Workload
    container: Object
    folder: Path
    found: dict[str, str]
    words: list[str]
    process: subprocess.Popen[bytes] | None = field(default=None)

    @property
    def name(self) -> str:
        return self.workload.name

    @property
    def is_running(self) -> bool:
        return self.process is not None and self.process.poll() is None

    @property
    def log(self) -> str:
        return (self.folder / "log").read_text(errors="replace")

    def start(self) -> None:
        """Starts the process like a new container."""
        others = {name: value for name, value in os.environ.items() if not name.startswith("LODESTONE_")}
        with (self.folder / "log").open("ab") as log:
            self.process = subprocess.Popen(
                [str(self.binary), *self.words],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                cwd=self.folder,
                env={**others, **self.found},
            )

    def complaint(self, probe: str) -> str | None:
        """Runs a probe and returns its complaint, or None if it passes."""
        if not self.is_running:
            return f"{self.name}: is not running; it said {self.log[-600:]!r}"
        command = self.container[probe]["exec"]["command"]
        done = settings.call(self.binary, command[1:], self.found)
        return None if done.returncode == 0 else f"{self.name}: {probe}: {(done.stdout + done.stderr).strip()}"

    def peak_mb(self) -> float:
        """Returns the peak memory of the process."""
        assert self.process is not None
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(re.findall(r"VmHWM:\s+(\d+) kB", status)[0]) / 1000

    def stop(self) -> str | None:
        """Sends SIGTERM as on pod deletion. Returns a complaint unless the process exits with 0 in its grace period."""
        if self.process is None or self.process.poll() is not None:
            return f"{self.name}: had ended before; it said {self.log[-600:]!r}"
        grace_s = self.workload.pod["terminationGracePeriodSeconds"]
        self.process.send_signal(signal.SIGTERM)
        try:
            status = self.process.wait(timeout=grace_s)
        except subprocess.TimeoutExpired:
            return f"{self.name}: still ran {grace_s} s after SIGTERM"
        return None if status == 0 else f"{self.name}: exit {status} after SIGTERM; it said {self.log[-600:]!r}"

    def kill(self) -> None:
        """Kills the process if it is still running, for cleanup."""
        if self.process is not None and self.process.poll() is None:
            self.process.kill()
            self.process.wait()


def pods_of(objects: list[Object], kubectl: str, binary: Path, scratch: Path) -> dict[str, Pod]:
    """Creates one pod per role, ready to start."""
    objects = copy.deepcopy(objects)
    of_kind(objects, "ConfigMap")[0]["data"] |= RUN
    secrets = {secret["metadata"]["name"]: secret for secret in keys.make(kubectl, scratch / "keys")}
    port = free_port()
    made: dict[str, Pod] = {}
    for workload, container in containers(objects):
        folder = scratch / "pods" / workload.name
        mount(secrets[f"keys-{workload.role}"], folder / "keys")
        for name in ("tmp", "runs"):
            (folder / name).mkdir()
        here = placer(folder, port)
        found = settings.variables(objects, workload, container)
        words = [here(text) for text in settings.arguments(container, found)]
        found = {name: here(value) for name, value in found.items()}
        if "LODESTONE_DASHBOARD__WEB__TOKEN" in found:
            found["LODESTONE_DASHBOARD__WEB__TOKEN"] = keys.files(secrets["evaluator-page"])["token"].decode()
        made[workload.role] = Pod(binary, workload, container, folder, found, words)
    return made


def placer(folder: Path, port: int) -> Callable[[str], str]:
    """Returns a function that replaces the cluster's paths and addresses with the pod's folders and loopback."""

    def place(text: str) -> str:
        text = re.sub(r"\b(quic|tls)/(0\.0\.0\.0|router):7447\b", rf"\1/127.0.0.1:{port}", text)
        text = text.replace("--web=0.0.0.0:8080", "--web=127.0.0.1:0")
        return FOLDER.sub(lambda match: str(folder / match[1]), text)

    return place


def until(holds: Callable[[], bool]) -> bool:
    """Polls like the kubelet does with probes. Returns whether the condition held before the deadline."""
    end = time.monotonic() + DEADLINE_S
    while not holds():
        if time.monotonic() > end:
            return False
        time.sleep(PERIOD_S)
    return True


def wait(pods: list[Pod], probe: str) -> list[str]:
    """Waits until the probe passes for all pods, one has exited, or time is up. Returns the remaining complaints."""
    left: list[str] = []

    def is_over() -> bool:
        left[:] = [complaint for pod in pods if (complaint := pod.complaint(probe))]
        return not left or any(not pod.is_running for pod in pods)

    until(is_over)
    return left


def answer_of(address: str, headers: dict[str, str]) -> int | str:
    """Returns the HTTP status of the response, or the reason why there is none."""
    try:
        with urllib.request.urlopen(urllib.request.Request(address, headers=headers), timeout=10) as answer:
            return int(answer.status)
    except urllib.error.HTTPError as error:
        return error.code
    except OSError as error:
        return str(error)


def page_complaints(pod: Pod) -> Iterator[str]:
    """Checks that `/healthz` is open to everyone and that the metrics require the token."""
    address = PAGE.search(pod.log)
    if address is None:
        yield f"the evaluator does not say where its page is: {pod.log[-600:]!r}"
        return
    token = pod.found["LODESTONE_DASHBOARD__WEB__TOKEN"]
    for path, headers, wanted in (
        ("/healthz", {}, 200),
        ("/metrics", {}, 401),
        ("/metrics", {"Authorization": f"Bearer {token}"}, 200),
        ("/metrics", {"Host": "localhost"}, 401),
    ):
        status = answer_of(address[0] + path, headers)
        if status != wanted:
            yield f"{path} with the headers {sorted(headers)} answers {status}, not {wanted}"


def memory_complaints(pods: list[Pod]) -> Iterator[str]:
    """Prints the peak memory of each process and checks that it is below the limit."""
    for pod in pods:
        if complaint := pod.complaint("livenessProbe"):
            yield complaint
            continue
        resources = pod.container["resources"]
        peak, limit = pod.peak_mb(), float(quantity(resources["limits"]["memory"])) / 10**6
        asked = float(quantity(resources["requests"]["memory"])) / 10**6
        print(f"        {pod.name}: at most {peak:.0f} MB; asks for {asked:.0f}, its limit is {limit:.0f}")
        if peak > limit:
            yield f"{pod.name}: took {peak:.0f} MB, above its limit of {limit:.0f}"


def saved(pod: Pod) -> list[int]:
    """Returns the environment steps of the learner's checkpoints, in order."""
    folder = pod.folder / "runs" / RUN["LODESTONE_RUN"] / "checkpoints"
    return sorted(int(path.name.removeprefix("step-")) for path in folder.glob("step-*"))


def n_updates(learner: Pod) -> int:
    """Returns the number of updates in the run's metrics."""
    file = learner.folder / "runs" / RUN["LODESTONE_RUN"] / "metrics.jsonl"
    return file.read_text().count("\n") if file.exists() else 0


def learned(learner: Pod) -> str | None:
    """Waits for another update and returns a complaint if there is none."""
    before = n_updates(learner)
    is_added = until(lambda: n_updates(learner) > before or not learner.is_running)
    if is_added and learner.is_running:
        return None
    return f"the learner made no update after the first {before}; it said {learner.log[-600:]!r}"


def carried_on(learner: Pod) -> Iterator[str]:
    """Checks that a restarted learner finds its run and continues it."""
    for complaint in (learned(learner), learner.stop()):
        if complaint:
            yield complaint
            return
    before = saved(learner)
    learner.start()
    for complaint in (*wait([learner], "readinessProbe"), learned(learner), learner.stop()):
        if complaint:
            yield complaint
    if not before or saved(learner)[-1] <= before[-1]:
        yield f"checkpoints after the steps {before} became {saved(learner)}: the run did not go on"


def at_an_end(learner: Pod) -> Iterator[str]:
    """Checks that the learner of a finished run exits with 0 every time it is started."""
    for _ in range(2):
        done = settings.call(learner.binary, learner.words, {**learner.found, "LODESTONE_STEPS": "1"})
        if done.returncode != 0:
            yield f"exit {done.returncode}: {done.stderr[-600:]!r}"


def judge(report: Report, kubectl: str, binary: Path, objects: list[Object], scratch: Path) -> None:
    """Checks a run from its first probe to its end."""
    pods = pods_of(objects, kubectl, binary, scratch)
    # The router starts last, because pods in a cluster start in any order.
    order = [pods[role] for role in ("actor", "evaluator", "learner", "router")]
    try:
        for pod in order[:-1]:
            pod.start()
        for probe in ("startupProbe", "livenessProbe"):
            left = wait(order[:-1], probe)
            report.judge(f"as processes: without a router {probe} holds", left)
            if left:
                report.skip("what follows in the life of the processes", "they did not start")
                return
        unready = [pod.name for pod in order[:-1] if not pod.complaint("readinessProbe")]
        report.judge("as processes: without a router nobody is ready", (f"{name} is" for name in unready))
        order[-1].start()
        for probe in PROBES:
            left = wait(order, probe)
            report.judge(f"as processes: with a router {probe} holds", left)
            if left:
                report.skip("what follows in the life of the processes", "they are not well")
                return
        report.judge("as processes: the page asks for its token", page_complaints(pods["evaluator"]))
        report.judge("as processes: a learner carries its run on", carried_on(pods["learner"]))
        pods["learner"].start()
        report.judge("as processes: a router ends on SIGTERM", filter(None, [pods["router"].stop()]))
        report.judge("as processes: nobody is restarted for a router that is gone", wait(order[:-1], "livenessProbe"))
        pods["router"].start()
        report.judge("as processes: all are ready again", wait(order, "readinessProbe"))
        report.judge("as processes: memory stays below the limits", memory_complaints(order))
        ends = [pod.stop() for pod in order[:-1]]
        # Runs last, because the run stores the number of steps it is given.
        report.judge("as processes: a learner whose run has its steps ends well", at_an_end(pods["learner"]))
        ends.append(order[-1].stop())
        report.judge("as processes: all end well within their grace periods", filter(None, ends))
    finally:
        for pod in order:
            pod.kill()

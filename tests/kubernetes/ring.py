"""The pods of a run as processes of this machine: arguments, variables, Secrets and probes as they were rendered.

What a cluster adds is left out: its network (everything is on loopback), its users and its read-only root.
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
    """Keys as docs/kubernetes.md has them made."""
    done = settings.call(binary, ["keys", "new", str(folder), "--host", "router"], {})
    if done.returncode != 0:
        raise SystemExit(f"`lodestone keys new` failed: {done.stderr.strip()}")


def free_port() -> int:
    """One that nobody has now. A router cannot say which it took, since its clients must know before."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


def mount(secret: Object, folder: Path) -> None:
    """Lays the files as the kubelet does: behind two symbolic links, readable to owner and group."""
    version = folder / "..2026"
    version.mkdir(parents=True)
    (folder / "..data").symlink_to(version.name)
    for name, content in keys.files(secret).items():
        (version / name).write_bytes(content)
        (version / name).chmod(0o440)
        (folder / name).symlink_to(f"..data/{name}")


@dataclass
class Pod:
    """One pod, which may be ended and begun again with the same volumes."""

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
        """As a container that has just been made."""
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
        """What a probe says against the pod."""
        if not self.is_running:
            return f"{self.name}: is not running; it said {self.log[-600:]!r}"
        command = self.container[probe]["exec"]["command"]
        done = settings.call(self.binary, command[1:], self.found)
        return None if done.returncode == 0 else f"{self.name}: {probe}: {(done.stdout + done.stderr).strip()}"

    def peak_mb(self) -> float:
        """Most memory that the process has had."""
        assert self.process is not None
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(re.findall(r"VmHWM:\s+(\d+) kB", status)[0]) / 1000

    def stop(self) -> str | None:
        """SIGTERM as at the end of a pod; a complaint if it does not end well within its grace period."""
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
        """For the end of the check, whatever happened."""
        if self.process is not None and self.process.poll() is None:
            self.process.kill()
            self.process.wait()


def pods_of(objects: list[Object], kubectl: str, binary: Path, scratch: Path) -> dict[str, Pod]:
    """One pod of each role, ready to start."""
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
    """Puts the pod's folders and the loopback in the place of what a cluster has."""

    def place(text: str) -> str:
        text = re.sub(r"^quic/(0\.0\.0\.0|router):7447$", f"quic/127.0.0.1:{port}", text)
        text = text.replace("--web=0.0.0.0:8080", "--web=127.0.0.1:0")
        return FOLDER.sub(lambda match: str(folder / match[1]), text)

    return place


def until(holds: Callable[[], bool]) -> bool:
    """Asks again and again, as the kubelet does with probes; whether it came to hold before the deadline."""
    end = time.monotonic() + DEADLINE_S
    while not holds():
        if time.monotonic() > end:
            return False
        time.sleep(PERIOD_S)
    return True


def wait(pods: list[Pod], probe: str) -> list[str]:
    """What a probe still says when all pods are well, one has ended or time is up."""
    left: list[str] = []

    def is_over() -> bool:
        left[:] = [complaint for pod in pods if (complaint := pod.complaint(probe))]
        return not left or any(not pod.is_running for pod in pods)

    until(is_over)
    return left


def answer_of(address: str, headers: dict[str, str]) -> int | str:
    """The status of an answer, or why there is none."""
    try:
        with urllib.request.urlopen(urllib.request.Request(address, headers=headers), timeout=10) as answer:
            return int(answer.status)
    except urllib.error.HTTPError as error:
        return error.code
    except OSError as error:
        return str(error)


def page_complaints(pod: Pod) -> Iterator[str]:
    """Anybody may ask whether the page is there, and whoever has the token for what is on it."""
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
    """Prints what each took, which must be below its limit."""
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
    """Environment steps after which the learner's checkpoints were written."""
    folder = pod.folder / "runs" / RUN["LODESTONE_RUN"] / "checkpoints"
    return sorted(int(path.name.removeprefix("step-")) for path in folder.glob("step-*"))


def n_updates(learner: Pod) -> int:
    """Updates that stand in the run's metrics."""
    file = learner.folder / "runs" / RUN["LODESTONE_RUN"] / "metrics.jsonl"
    return file.read_text().count("\n") if file.exists() else 0


def learned(learner: Pod) -> str | None:
    """A complaint if no update is added."""
    before = n_updates(learner)
    is_added = until(lambda: n_updates(learner) > before or not learner.is_running)
    if is_added and learner.is_running:
        return None
    return f"the learner made no update after the first {before}; it said {learner.log[-600:]!r}"


def carried_on(learner: Pod) -> Iterator[str]:
    """A learner that is ended and begun again finds its run and takes it further."""
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
    """A run that has its steps is over: the learner ends well, as often as it is started."""
    for _ in range(2):
        done = settings.call(learner.binary, learner.words, {**learner.found, "LODESTONE_STEPS": "1"})
        if done.returncode != 0:
            yield f"exit {done.returncode}: {done.stderr[-600:]!r}"


def judge(report: Report, kubectl: str, binary: Path, objects: list[Object], scratch: Path) -> None:
    """A run from its first probe to its end."""
    pods = pods_of(objects, kubectl, binary, scratch)
    # The router comes last: in a cluster nobody waits for anybody.
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
        # Not before, because the run remembers how many steps it was given.
        report.judge("as processes: a learner whose run has its steps ends well", at_an_end(pods["learner"]))
        ends.append(order[-1].stop())
        report.judge("as processes: all end well within their grace periods", filter(None, ends))
    finally:
        for pod in order:
            pod.kill()

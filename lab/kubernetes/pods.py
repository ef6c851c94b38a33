"""Runs the pods of a run as local processes, with the rendered arguments, variables, Secrets, and probes.

Does not reproduce the cluster's network (everything is on loopback), users, or read-only root.
"""

import copy
import re
import urllib.error
import urllib.request
from collections.abc import Iterable
from pathlib import Path

from ..ring import records
from ..ring.checks import Failed, Tally, require, require_none, until
from ..ring.processes import Process, free_port, plain_environment
from . import program, secrets
from .manifests import Object, Workload, of_kind, quantity, workloads
from .operators import UNFINISHED
from .rules import PROBES

# The smallest task that needs the whole ring.
RUN = {"LODESTONE_PRESET": "smoke", "LODESTONE_RUN": "smoke"}
DEADLINE_S = 180.0
MOUNTED = re.compile(r"(?<![\w./])/(keys|tmp|runs)(?=/|$)")
TOKEN = "LODESTONE_DASHBOARD__WEB__TOKEN"


class Pod:
    """One pod, which can be stopped and restarted with the same volumes."""

    def __init__(self, binary: Path, objects: list[Object], workload: Workload, folder: Path, port: int) -> None:
        self.name = workload.name
        self.workload = workload
        self.binary = binary
        self.folder = folder
        self.run_dir = folder / "runs" / RUN["LODESTONE_RUN"]
        self.process: Process
        for name in ("tmp", "runs"):
            (folder / name).mkdir(parents=True)

        def here(text: str) -> str:
            """Replaces the cluster's paths and addresses with the pod's folders and loopback."""
            text = re.sub(r"\b(quic|tls)/(0\.0\.0\.0|router):7447\b", rf"\1/127.0.0.1:{port}", text)
            text = text.replace("--web=0.0.0.0:8080", "--web=127.0.0.1:0")
            return MOUNTED.sub(lambda match: str(folder / match[1]), text)

        found = program.variables(objects, workload)
        self.words = [here(text) for text in program.arguments(workload, found)]
        self.found = {name: here(value) for name, value in found.items()}

    def mount(self, secret: Object) -> None:
        """Lays out the keys like the kubelet: behind two symbolic links, readable by owner and group."""
        folder = self.folder / "keys"
        version = folder / "..2026"
        version.mkdir(parents=True)
        (folder / "..data").symlink_to(version.name)
        for name, content in secrets.files(secret).items():
            (version / name).write_bytes(content)
            (version / name).chmod(0o440)
            (folder / name).symlink_to(f"..data/{name}")

    def start(self) -> None:
        environment = {**plain_environment(), **self.found}
        self.process = Process([self.binary, *self.words], self.folder / "log", environment, self.folder)

    def complaint(self, probe: str) -> str | None:
        """Runs a probe and returns its complaint, or None if it passes."""
        done = program.call(self.binary, self.workload.box[probe]["exec"]["command"][1:], self.found)
        return None if done.returncode == 0 else f"{self.name}: {(done.stdout + done.stderr).strip()}"

    def must_run(self) -> bool:
        """Fails if the process has ended."""
        require(self.process.code is None, f"{self.name} has ended; it said {self.process.said()}")
        return True

    def stop(self) -> None:
        """Sends SIGTERM as on pod deletion. The process must exit as it should in its grace period."""
        code = UNFINISHED if self.workload.role == "learner" else 0
        self.process.end(self.workload.pod["terminationGracePeriodSeconds"], code)

    def learns(self) -> None:
        before = len(records.entries(self.run_dir))
        until("an update", DEADLINE_S, lambda: len(records.entries(self.run_dir)) > before, self.must_run)


def made(objects: list[Object], kubectl: str, binary: Path, scratch: Path) -> dict[str, Pod]:
    """Creates one pod per role, ready to start."""
    objects, port = copy.deepcopy(objects), free_port()
    of_kind(objects, "ConfigMap")[0]["data"] |= RUN
    keys = secrets.make(kubectl, scratch / "keys")
    found = {}
    for workload in workloads(objects):
        pod = found[workload.role] = Pod(binary, objects, workload, scratch / "pods" / workload.name, port)
        pod.mount(keys[f"keys-{workload.role}"])
        if TOKEN in pod.found:
            pod.found[TOKEN] = secrets.files(keys["evaluator-page"])["token"].decode()
    return found


def passes(pods: Iterable[Pod], probe: str) -> None:
    """Waits until the probe passes for all pods. Fails if one ends."""

    def all_pass() -> bool:
        require_none(complaint for pod in pods if (complaint := pod.complaint(probe)))
        return True

    until(f"{probe} of all", DEADLINE_S, all_pass, lambda: [pod.must_run() for pod in pods], (Failed,))


def page_is_closed(pod: Pod) -> None:
    """Checks that `/healthz` is open to everyone and that the metrics require the token."""
    address = re.search(r"http://127\.0\.0\.1:\d+", pod.process.log.read_text(errors="replace"))
    require(address, f"the evaluator does not say where its page is: {pod.process.said()}")
    for path, headers, wanted in (
        ("/healthz", {}, 200),
        ("/metrics", {}, 401),
        ("/metrics", {"Authorization": f"Bearer {pod.found[TOKEN]}"}, 200),
        ("/metrics", {"Host": "localhost"}, 401),
    ):
        request = urllib.request.Request(f"{address[0] if address else ''}{path}", headers=headers)
        try:
            with urllib.request.urlopen(request, timeout=10) as answer:
                status = int(answer.status)
        except urllib.error.HTTPError as error:
            status = error.code
        require(status == wanted, f"{path} with the headers {sorted(headers)} answers {status}, not {wanted}")


def memory_fits(pods: list[Pod]) -> str:
    """Checks that the peak memory of each process is below its limit."""
    said = []
    for pod in pods:
        pod.must_run()
        peak = (pod.process.status("VmHWM") or 0) / 1000
        asked, limit = (float(quantity(pod.workload.box["resources"][of]["memory"])) / 1e6 for of in ("requests", "limits"))
        require(peak <= limit, f"{pod.name}: took {peak:.0f} MB, above its limit of {limit:.0f}")
        said.append(f"{pod.name} {peak:.0f} of {asked:.0f} to {limit:.0f} MB")
    return ", ".join(said)


def carries_on(learner: Pod) -> None:
    """Checks that a restarted learner finds its run and continues it."""
    learner.learns()
    learner.stop()
    before = records.saved_steps(learner.run_dir)
    learner.start()
    passes([learner], "readinessProbe")
    learner.learns()
    learner.stop()
    after = records.saved_steps(learner.run_dir)
    require(0 < before < after, f"a checkpoint after {before} steps became one after {after}: the run did not go on")


def ends_again(learner: Pod) -> None:
    """Checks that the learner of a finished run exits with 0 every time it is started."""
    for _ in range(2):
        done = program.call(learner.binary, learner.words, {**learner.found, "LODESTONE_STEPS": "1"})
        require(done.returncode == 0, f"exit {done.returncode}: {done.stderr[-600:]!r}")


def judge(tally: Tally, pods: dict[str, Pod]) -> None:
    """Checks a run from its first probe to its end, unless it does not get that far."""
    # The router starts last, because pods in a cluster start in any order.
    *clients, router = order = [pods[role] for role in ("actor", "evaluator", "learner", "router")]
    learner = pods["learner"]
    for pod in clients:
        pod.start()
    for probe in ("startupProbe", "livenessProbe"):
        if not tally.check(f"as processes: without a router {probe} holds", lambda: passes(clients, probe)):
            return
    ready = (f"{pod.name} is" for pod in clients if not pod.complaint("readinessProbe"))
    tally.check("as processes: without a router nobody is ready", lambda: require_none(ready))
    router.start()
    for probe in PROBES:
        if not tally.check(f"as processes: with a router {probe} holds", lambda: passes(order, probe)):
            return
    tally.check("as processes: the page asks for its token", lambda: page_is_closed(pods["evaluator"]))
    tally.check("as processes: a learner carries its run on", lambda: carries_on(learner))
    learner.start()
    tally.check("as processes: a router ends on SIGTERM", router.stop)
    tally.check("as processes: nobody is restarted for a router that is gone", lambda: passes(clients, "livenessProbe"))
    router.start()
    tally.check("as processes: all are ready again", lambda: passes(order, "readinessProbe"))
    tally.check("as processes: memory stays below the limits", lambda: memory_fits(order))
    for pod in clients:
        tally.check(f"as processes: {pod.name} ends well within its grace period", pod.stop)
    # Runs last, because the run stores the number of steps it is given.
    tally.check("as processes: a learner whose run has its steps ends well", lambda: ends_again(learner))
    tally.check("as processes: router ends well within its grace period", router.stop)

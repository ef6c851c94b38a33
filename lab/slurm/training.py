"""A training launched by `lodestone-slurm`, as its user sees it: commands, the queue, and the files in its folder."""

import json
import os
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Self

from ..ring import records
from ..ring.checks import require, until
from ..ring.processes import ENDLESS, ROOT, attempt, run
from . import conf, queue
from .cluster import Cluster

COMMAND = ROOT / "deploy" / "slurm" / "lodestone-slurm"

N_ACTORS = 3

SETTINGS = {
    # How often actors look for the endpoint, 10 s by default.
    "LODESTONE_SLURM_POLL_S": "1",
    # Learner settings can be passed like this. Frequent checkpoints leave something to resume from when a node fails.
    "LODESTONE_LEARNER__CHECKPOINTS__EVERY_UPDATES": "2",
}
"""Variables in the environment of `launch`."""

PARTITIONS = ("--learner-partition", conf.LEARNERS, "--actor-partition", conf.ACTORS)


class Training:
    """A run in `folder` on a cluster. Each check continues where the previous one ended."""

    def __init__(self, cluster: Cluster, binary: Path, folder: Path) -> None:
        self.cluster = cluster
        self.binary = binary
        self.folder = folder
        self.run_dir = folder / "run"
        self.returning: Future[bool] | None = None
        """Ends when the node that was mended last is in use again."""

    def other(self, name: str) -> Self:
        """Returns another run on the same cluster, which has not started."""
        return type(self)(self.cluster, self.binary, self.folder.with_name(name))

    def attempt(self, *words: str) -> tuple[int, str]:
        """Runs `lodestone-slurm` and returns its exit code and all of its output."""
        command, *options = words
        done = attempt([COMMAND, command, "--dir", self.folder, *options], {**os.environ, **SETTINGS})
        return done.returncode, done.stdout + done.stderr

    def command(self, *words: str) -> str:
        """Runs `lodestone-slurm` and returns its output. Fails if the command does."""
        code, printed = self.attempt(*words)
        require(code == 0, f"{COMMAND.name} {words} ended with {code}: {printed}")
        return printed

    def launch(self, *options: str) -> str:
        """Launches or continues the run and returns the command's output."""
        return self.command("launch", "--binary", str(self.binary), *options)

    def options(self, n_steps: int = ENDLESS) -> list[str]:
        """Returns the launch options, without time limits."""
        learning = ["--preset", "smoke", "--steps", str(n_steps), "--seed", "1"]
        return [*learning, "--actors", str(N_ACTORS), "--learner-cpus", "2", *PARTITIONS]

    def stop(self) -> str:
        """Lets the learner save, then ends the run."""
        return self.command("stop", "--wait", "60")

    def job_of(self, *roles: str) -> str:
        """Returns the id of the job that `launch` noted for one of these roles."""
        jobs = [line.split() for line in (self.folder / "jobs").read_text().splitlines()]
        return next(words[1] for words in jobs if words[0] in roles)

    def learner_job(self) -> str:
        return self.job_of("learner", "hetjob")

    def actor_job(self) -> str:
        return self.job_of("actors")

    def learner_node(self) -> str:
        return queue.job(self.learner_job())["NodeList"]

    def endpoint(self) -> str | None:
        path = self.folder / "endpoint"
        return path.read_text().splitlines()[0] if path.exists() else None

    def learner_log(self) -> str:
        """Returns the log of the learner's job, including earlier processes."""
        return (self.folder / "logs" / f"learner-{self.learner_job()}.log").read_text()

    def is_finished(self) -> bool:
        return (self.folder / "finished").exists()

    def updates(self) -> list[records.Update]:
        return records.entries(self.run_dir)

    def n_steps(self) -> int:
        updates = self.updates()
        return int(updates[-1]["n_env_steps"]) if updates else 0

    def n_saved_steps(self) -> int:
        return records.saved_steps(self.run_dir)

    def success(self, n_evaluations: int) -> float:
        """Returns the lowest success rate in the evaluator's last evaluations, or 0 if there are too few."""
        evaluations = records.entries(self.run_dir, "eval/summary")
        rates = [float(found["all"]["sampled"]["success"]["rate"]) for found in evaluations]
        return min(rates[-n_evaluations:]) if len(rates) >= n_evaluations else 0.0

    def evaluated(self) -> float:
        """Returns the success rate of the run's policy according to `lodestone eval`."""
        report = json.loads(run([self.binary, "eval", "--checkpoint", self.run_dir, "--json"], seconds=900))
        return float(report["summary"]["all"]["sampled"]["success"]["rate"])

    def processes(self, role: str) -> dict[Path, list[str]]:
        """Returns the folders in /proc and the words of the processes of this role, on whatever node."""
        found = {}
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                words = (folder / "cmdline").read_bytes().decode(errors="replace").split("\0")
            except OSError:
                continue  # It has ended.
            if words[:2] == [str(self.binary), role]:
                found[folder] = words
        return found

    def actors_that_work(self) -> set[str]:
        """Returns the ids of the actors with a process on some node."""
        return {words[words.index("--id") + 1] for words in self.processes("actor").values()}

    def all_run(self) -> bool:
        """Returns whether Slurm reports all actors as running."""
        return len(queue.running(self.actor_job())) == N_ACTORS

    def check(self) -> None:
        """Fails if the learner's job has failed for good."""
        state = queue.state(self.learner_job())
        require(state not in ("FAILED", "TIMEOUT", "NODE_FAIL", "OUT_OF_MEMORY"), f"the learner's job is {state}")

    def wait(self, what: str, limit_s: float, condition: Callable[[], object]) -> None:
        """Waits for a condition as long as the learner's job has not failed."""
        until(what, limit_s, condition, self.check)

    def wait_for_all_actors(self, limit_s: float) -> None:
        """Waits until every task of the array has a working actor."""
        until(f"{N_ACTORS} actors work", limit_s, lambda: self.all_run() and len(self.actors_that_work()) == N_ACTORS)

    def wait_for_steps(self) -> None:
        """Waits for an update with more steps than there are now."""
        steps = self.n_steps()
        self.wait(f"more than {steps} steps", 90, lambda: self.n_steps() > steps)

    def wait_for_steps_beyond(self, saved: int) -> None:
        """Waits for the first update from now on. It must go on from what was saved."""
        n_updates = len(self.updates())
        self.wait("the learner steps again", 120, lambda: len(self.updates()) > n_updates)
        first = self.updates()[n_updates]["n_env_steps"]
        require(first > saved, f"the learner began again at {first} steps, {saved} were saved")


Check = Callable[[Training], None]

"""A training that `lodestone-slurm` launched, as its user sees it: commands, the queue, and the files in its folder."""

from __future__ import annotations

import json
import os
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import conf
import queue_of_slurm as queue
from wait import wait_for

REPOSITORY = Path(__file__).resolve().parents[2]
COMMAND = REPOSITORY / "deploy" / "slurm" / "lodestone-slurm"

FEW_EPISODES = 30
"""Fewer than this say little about success."""

SETTINGS = {
    # How often actors look for the endpoint; 10 s unless told otherwise.
    "LODESTONE_SLURM_POLL_S": "1",
    # A setting of the learner reaches it like this; here, to have something to go on from when a node fails.
    "LODESTONE_LEARNER__CHECKPOINTS__EVERY_UPDATES": "2",
}
"""Variables in the environment of `launch`."""


@dataclass
class Launched:
    """A run in `folder`, which may not have begun."""

    binary: Path
    folder: Path

    def launch(self, *options: str) -> str:
        """Launches or continues the run; what the command printed."""
        return self.command("launch", "--binary", str(self.binary), *options)

    def stop(self) -> str:
        """Lets the learner save and ends the run."""
        return self.command("stop", "--wait", "60")

    def status(self) -> str:
        """What `status` prints."""
        return self.command("status")

    def command(self, command: str, *options: str) -> str:
        """Runs `lodestone-slurm`; its output. Fails when it fails."""
        code, printed = self.attempt(command, *options)
        if code != 0:
            raise AssertionError(f"{COMMAND.name} {command} ended with {code}: {printed}")
        return printed

    def attempt(self, command: str, *options: str) -> tuple[int, str]:
        """Runs `lodestone-slurm`; its exit code and all that it printed."""
        done = subprocess.run(
            [COMMAND, command, "--dir", self.folder, *options],
            env={**os.environ, **SETTINGS}, capture_output=True, text=True, check=False,
        )  # fmt: skip
        return done.returncode, done.stdout + done.stderr

    def learner_job(self) -> str:
        """Id of the job with the learner."""
        return next(words[1] for words in self._jobs() if words[0] in ("learner", "hetjob"))

    def actor_job(self) -> str:
        """Id of the array of actors."""
        return next(words[1] for words in self._jobs() if words[0] == "actors")

    def _jobs(self) -> list[list[str]]:
        return [line.split() for line in (self.folder / "jobs").read_text(encoding="utf-8").splitlines()]

    def endpoint(self) -> str | None:
        """Where the router is."""
        path = self.folder / "endpoint"
        return path.read_text(encoding="utf-8").splitlines()[0] if path.exists() else None

    def learner_log(self) -> str:
        """What the learner's job has printed, in all its lives."""
        return (self.folder / "logs" / f"learner-{self.learner_job()}.log").read_text(encoding="utf-8")

    def is_finished(self) -> bool:
        """Whether the run's steps are reached."""
        return (self.folder / "finished").exists()

    def n_steps(self) -> int:
        """Environment steps of the newest update."""
        updates = self.metrics("learner")
        return int(updates[-1]["n_env_steps"]) if updates else 0

    def n_saved_steps(self) -> int:
        """Environment steps of the newest checkpoint."""
        names = [path.name for path in self.folder.glob("run/checkpoints/step-*")]
        return max((int(name.removeprefix("step-")) for name in names), default=0)

    def metrics(self, key: str) -> list[dict[str, Any]]:
        """All lines of metrics.jsonl with this key; every line must be whole."""
        path = self.folder / "run" / "metrics.jsonl"
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        # The last line may be on its way.
        lines = text.splitlines() if text.endswith("\n") else text.splitlines()[:-1]
        return [metrics for metrics in map(json.loads, lines) if metrics["key"] == key]

    def success(self, n_passes: int) -> float:
        """The lowest success rate in the last passes of the evaluator; 0 before there are as many."""
        rates = [float(found["all"]["mode"]["success"]["rate"]) for found in self.metrics("eval/summary")]
        return min(rates[-n_passes:]) if len(rates) >= n_passes else 0.0

    def sampled_success(self) -> float:
        """Success rate of the training episodes that ended in the newest update, whose actions are sampled; 0 of few."""
        updates = self.metrics("learner")
        success = updates[-1]["episodes"]["success"] if updates else {"n_episodes": 0}
        return float(success["rate"]) if success["n_episodes"] >= FEW_EPISODES else 0.0

    def actors_that_work(self) -> set[str]:
        """Actors whose processes work on some node, by id."""
        found = set()
        for line in Path("/proc").glob("[0-9]*/cmdline"):
            try:
                words = line.read_bytes().split(b"\0")
            except OSError:
                continue  # It has ended.
            if words[0] == os.fsencode(self.binary) and words[1:2] == [b"actor"]:
                found.add(words[words.index(b"--id") + 1].decode())
        return found

    def wait_for_steps(self, beyond: int, limit_s: float) -> int:
        """Waits until an update has more steps than `beyond`; their number."""
        wait_for(f"more than {beyond} steps", lambda: self.n_steps() > beyond, limit_s, self.check)
        return self.n_steps()

    def check(self) -> None:
        """Fails when the learner's job has failed for good."""
        state = queue.state(self.learner_job())
        if state in ("FAILED", "TIMEOUT", "NODE_FAIL", "OUT_OF_MEMORY"):
            raise AssertionError(f"the learner's job is {state}")

    def judged(self) -> float:
        """Success rate of the newest checkpoint, as `lodestone eval` finds it."""
        judge = [str(self.binary), "eval", "--checkpoint", str(self.folder / "run"), "--json"]
        report = json.loads(subprocess.run(judge, capture_output=True, check=True).stdout)
        return float(report["summary"]["all"]["mode"]["success"]["rate"])


def partitions() -> list[str]:
    """Options that send learner and actors to the partitions of the test cluster."""
    return ["--learner-partition", conf.LEARNERS, "--actor-partition", conf.ACTORS]

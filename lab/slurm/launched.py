"""A training launched by `lodestone-slurm`, as its user sees it: commands, the queue, and the files in its folder."""

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
    # How often actors look for the endpoint, 10 s by default.
    "LODESTONE_SLURM_POLL_S": "1",
    # Learner settings can be passed like this. Frequent checkpoints leave something to resume from when a node fails.
    "LODESTONE_LEARNER__CHECKPOINTS__EVERY_UPDATES": "2",
}
"""Variables in the environment of `launch`."""


@dataclass
class Launched:
    """A run in `folder` that may not have started yet."""

    binary: Path
    folder: Path

    def launch(self, *options: str) -> str:
        """Launches or continues the run and returns the command's output."""
        return self.command("launch", "--binary", str(self.binary), *options)

    def stop(self) -> str:
        """Lets the learner save, then ends the run."""
        return self.command("stop", "--wait", "60")

    def status(self) -> str:
        """Returns the output of `status`."""
        return self.command("status")

    def command(self, command: str, *options: str) -> str:
        """Runs `lodestone-slurm` and returns its output. Raises AssertionError if it fails."""
        code, printed = self.attempt(command, *options)
        if code != 0:
            raise AssertionError(f"{COMMAND.name} {command} ended with {code}: {printed}")
        return printed

    def attempt(self, command: str, *options: str) -> tuple[int, str]:
        """Runs `lodestone-slurm` and returns its exit code and all of its output."""
        done = subprocess.run(
            [COMMAND, command, "--dir", self.folder, *options],
            env={**os.environ, **SETTINGS}, capture_output=True, text=True, check=False,
        )  # fmt: skip
        return done.returncode, done.stdout + done.stderr

    def learner_job(self) -> str:
        """Returns the id of the learner's job."""
        return next(words[1] for words in self._jobs() if words[0] in ("learner", "hetjob"))

    def actor_job(self) -> str:
        """Returns the id of the actor array."""
        return next(words[1] for words in self._jobs() if words[0] == "actors")

    def _jobs(self) -> list[list[str]]:
        return [line.split() for line in (self.folder / "jobs").read_text(encoding="utf-8").splitlines()]

    def endpoint(self) -> str | None:
        """Returns the router's endpoint, or None."""
        path = self.folder / "endpoint"
        return path.read_text(encoding="utf-8").splitlines()[0] if path.exists() else None

    def learner_log(self) -> str:
        """Returns the log of the learner's job, including earlier processes."""
        return (self.folder / "logs" / f"learner-{self.learner_job()}.log").read_text(encoding="utf-8")

    def is_finished(self) -> bool:
        """Returns whether the run has reached its steps."""
        return (self.folder / "finished").exists()

    def n_steps(self) -> int:
        """Returns the environment steps of the newest update."""
        updates = self.metrics("learner")
        return int(updates[-1]["n_env_steps"]) if updates else 0

    def n_saved_steps(self) -> int:
        """Returns the environment steps of the newest checkpoint."""
        names = [path.name for path in self.folder.glob("run/checkpoints/step-*")]
        return max((int(name.removeprefix("step-")) for name in names), default=0)

    def metrics(self, key: str) -> list[dict[str, Any]]:
        """Returns all entries of metrics.jsonl with this key. Every line must be complete."""
        path = self.folder / "run" / "metrics.jsonl"
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        # The last line may still be incomplete.
        lines = text.splitlines() if text.endswith("\n") else text.splitlines()[:-1]
        return [metrics for metrics in map(json.loads, lines) if metrics["key"] == key]

    def success(self, n_passes: int) -> float:
        """Returns the lowest success rate in the evaluator's last passes, or 0 if there are too few passes."""
        rates = [float(found["all"]["greedy"]["success"]["rate"]) for found in self.metrics("eval/summary")]
        return min(rates[-n_passes:]) if len(rates) >= n_passes else 0.0

    def sampled_success(self) -> float:
        """Returns the success rate of the training episodes that ended in the newest update, or 0 if there are too few.

        Training episodes use sampled actions.
        """
        updates = self.metrics("learner")
        success = updates[-1]["episodes"]["success"] if updates else {"n_episodes": 0}
        return float(success["rate"]) if success["n_episodes"] >= FEW_EPISODES else 0.0

    def actors_that_work(self) -> set[str]:
        """Returns the ids of the actors with a process on some node."""
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
        """Waits until an update has more steps than `beyond` and returns their number."""
        wait_for(f"more than {beyond} steps", lambda: self.n_steps() > beyond, limit_s, self.check)
        return self.n_steps()

    def check(self) -> None:
        """Raises AssertionError if the learner's job has failed for good."""
        state = queue.state(self.learner_job())
        if state in ("FAILED", "TIMEOUT", "NODE_FAIL", "OUT_OF_MEMORY"):
            raise AssertionError(f"the learner's job is {state}")

    def judged(self) -> float:
        """Returns the success rate of the run's policy according to `lodestone eval`."""
        judge = [str(self.binary), "eval", "--checkpoint", str(self.folder / "run"), "--json"]
        report = json.loads(subprocess.run(judge, capture_output=True, check=True).stdout)
        return float(report["summary"]["all"]["greedy"]["success"]["rate"])


def partitions() -> list[str]:
    """Returns the options that assign learner and actors to the test cluster's partitions."""
    return ["--learner-partition", conf.LEARNERS, "--actor-partition", conf.ACTORS]

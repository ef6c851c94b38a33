"""Checks how `lodestone-slurm` reports mistakes and what happens to jobs that cannot work."""

from __future__ import annotations

import queue_of_slurm as queue
from launched import COMMAND, Launched, partitions
from training import Check, Training
from wait import wait_for


def a_rehearsal_changes_nothing(training: Training) -> None:
    """`--dry-run` prints both submissions and creates no folder."""
    run = Launched(training.run.binary, training.run.folder.with_name("rehearsal"))
    printed = run.launch("--actors", "2500", "--gpu", "--time", "12:00:00", "--dry-run", "--", "--account=lab")
    learner, *actors = [line for line in printed.splitlines() if line.startswith("+ sbatch")]
    assert "--gres=gpu:1" in learner and "--time=12:00:00" in learner and "--account=lab" in learner, learner
    # Slurm limits an array to 1001 tasks by default.
    assert [word for line in actors for word in line.split() if word.startswith("--array=")] == [
        "--array=0-1000", "--array=0-1000", "--array=0-497",
    ]  # fmt: skip
    assert not run.folder.exists()


def a_run_on_a_gpu_asks_for_one_again(training: Training) -> None:
    """A run that was launched with `--gpu` continues with a GPU, also without the option."""
    run = Launched(training.run.binary, training.run.folder.with_name("gpu"))
    (run.folder / "run").mkdir(parents=True)
    (run.folder / "run/config.toml").write_text('device = "gpu"\n')
    printed = run.launch("--dry-run")
    learner = next(line for line in printed.splitlines() if line.startswith("+ sbatch"))
    assert "--gres=gpu:1" in learner, learner


def mistakes_are_explained(training: Training) -> None:
    """A mistake exits with a code and a hint, and submits nothing."""
    run = Launched(training.run.binary, training.run.folder.with_name("mistakes"))
    binary = ["--binary", str(run.binary)]
    for options, code, hint in [
        (["launch", *binary, "--actors", "none"], 2, "valid is a number"),
        (["launch", *binary, "--actor", "8"], 2, "is no option"),
        (["launch", *binary, "--port", "0"], 2, "valid is a port from 1 to 65535"),
        (["launch", *binary, "--port", "7-6"], 2, "or FIRST-LAST"),
        (["launch", *binary, "--run", "My Run"], 2, "valid are 1 to 64 characters"),
        (["launch", *binary, "--preset", "quick"], 64, "nothing was submitted"),
        (["launch", "--binary", "/nowhere"], 64, "no program at /nowhere"),
        (["launch", *binary, "--preset", "near-goal", "--partition", "nowhere"], 1, "invalid partition"),
        (["status"], 1, "holds no run"),
        (["stop"], 1, "holds no run"),
        (["begin"], 2, "none of launch, status, stop"),
    ]:
        found, printed = run.attempt(*options)
        assert (found, hint in printed) == (code, True), f"{COMMAND.name} {options}: {found}, {printed}"


def a_learner_that_cannot_work_frees_the_actors(training: Training) -> None:
    """A learner job that cannot recover fails at once, prints the reason, and cancels the actors."""
    run = Launched(training.run.binary, training.run.folder.with_name("unreachable"))
    run.launch("--preset", "near-goal", "--actors", "2", "--learner-cpus", "2", "--interface", "nowhere0", *partitions())
    job, actors = run.learner_job(), run.actor_job()
    wait_for("the learner's job has failed", lambda: queue.state(job) == "FAILED", 40)
    assert "nowhere0 has no IPv4 address" in run.learner_log(), run.learner_log()
    wait_for("the actors' jobs are gone", lambda: not queue.is_queued(actors), 40)


CHECKS: list[Check] = [
    a_rehearsal_changes_nothing,
    a_run_on_a_gpu_asks_for_one_again,
    mistakes_are_explained,
    a_learner_that_cannot_work_frees_the_actors,
]

"""Learner and actors as one heterogeneous job."""

from __future__ import annotations

from pathlib import Path

import conf
import queue_of_slurm as queue
from training import Check, Training
from wait import wait_for

N_ACTORS = 2


def nothing_is_left(_: Training) -> None:
    """Cancels any jobs left by other checks."""
    queue.cancel_all()


def a_hetjob_trains(training: Training) -> None:
    """Learner and actors start together, only the learner gets the GPU, and all end when the steps are reached."""
    run = training.run
    printed = run.launch(
        "--preset", "near-goal", "--steps", "4096", "--actors", str(N_ACTORS), "--hetjob", "--no-evaluator",
        "--learner-cpus", "2", "--interface", "eth0", "--learner-sbatch=--gres=gpu:1", "--partition", conf.LEARNERS,
    )  # fmt: skip
    assert printed.count("+ sbatch") == 1, printed
    job = run.learner_job()
    wait_for("the actors work", lambda: len(run.actors_that_work()) == N_ACTORS, 60, run.check)
    assert "CUDA_VISIBLE_DEVICES" in environment("learner", run.binary)
    assert "CUDA_VISIBLE_DEVICES" not in environment("actor", run.binary)
    endpoint = run.endpoint()
    assert endpoint is not None and endpoint.startswith("quic/10."), endpoint
    queue.slurm("scontrol", "requeue", job)
    wait_for("the learner saved", lambda: "ended by term; saved at" in run.learner_log(), 60)
    wait_for("the actors work again", lambda: len(run.actors_that_work()) == N_ACTORS and run.endpoint() != endpoint, 60)
    wait_for("the run is finished", run.is_finished, 180, run.check)
    wait_for("the job is over", lambda: not queue.is_queued(job), 60)
    assert queue.state(job) == "COMPLETED"
    assert run.n_saved_steps() >= 4096
    wait_for("no actor is left", lambda: not run.actors_that_work(), 20)


def environment(role: str, binary: Path) -> dict[str, str]:
    """Returns the environment variables of a process of this role."""
    for process in Path("/proc").glob("[0-9]*"):
        try:
            words = (process / "cmdline").read_bytes().decode().split("\0")
            variables = (process / "environ").read_bytes().decode()
        except OSError:
            continue  # It has ended.
        if words[:2] == [str(binary), role]:
            return dict(pair.split("=", 1) for pair in variables.split("\0") if "=" in pair)
    raise AssertionError(f"no {role} runs")


CHECKS: list[Check] = [nothing_is_left, a_hetjob_trains]

"""Checks how `lodestone-slurm` reports mistakes, what happens to jobs that cannot work, and one heterogeneous job."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..ring.checks import until
from . import conf, queue
from .training import COMMAND, PARTITIONS, Check, Training


def a_rehearsal_changes_nothing(training: Training) -> None:
    """`--dry-run` prints both submissions and creates no folder."""
    run = training.other("rehearsal")
    printed = run.launch("--actors", "2500", "--gpu", "--time", "12:00:00", "--dry-run", "--", "--account=lab")
    learner, *actors = [line for line in printed.splitlines() if line.startswith("+ sbatch")]
    assert "--gres=gpu:1" in learner and "--time=12:00:00" in learner and "--account=lab" in learner, learner
    # Slurm limits an array to 1001 tasks by default.
    arrays = [word for line in actors for word in line.split() if word.startswith("--array=")]
    assert arrays == ["--array=0-1000", "--array=0-1000", "--array=0-497"], arrays
    assert not run.folder.exists()


def whole_nodes_take_one_actor_each(training: Training) -> None:
    """With `--actor-cpus node`, an actor has all cores of its node, and steps worlds with as many threads."""
    run = training.other("whole-nodes")
    task = ["--preset", "smoke", "--actors", "1", "--actor-cpus", "node", "--learner-cpus", "2", "--no-evaluator"]
    run.launch(*task, *PARTITIONS)
    run.wait("the actor works", 60, lambda: len(run.actors_that_work()) == 1)
    [words] = run.processes("actor").values()
    assert "actor.n_threads=3" in words, words
    assert queue.job(run.actor_job())["NumCPUs"] == "3", queue.job(run.actor_job())
    run.stop()


def a_launch_fits_into_the_queue(training: Training) -> None:
    """If fewer jobs may be in the queue than actors were asked for, `launch` submits those that fit, and says so."""
    run = training.other("limited")
    with accounts("5\n3\n"):
        printed = run.launch("--actors", "9", "--dry-run")
        assert "4 actors of 9 are submitted" in printed and "--array=0-3" in printed, printed
    with accounts("1\n"):
        code, printed = run.attempt("launch", "--binary", str(run.binary), "--dry-run")
        assert (code, "cancel some" in printed) == (1, True), printed


@contextmanager
def accounts(limits: str) -> Iterator[None]:
    """Puts a `sacctmgr` on PATH that prints these limits, one for each account: the cluster here keeps no accounts."""
    with tempfile.TemporaryDirectory() as folder:
        fake = Path(folder) / "sacctmgr"
        fake.write_text(f"#!/bin/sh\nprintf '{limits}'\n")
        fake.chmod(0o755)
        path = os.environ["PATH"]
        os.environ["PATH"] = f"{folder}{os.pathsep}{path}"
        try:
            yield
        finally:
            os.environ["PATH"] = path


def a_run_on_a_gpu_asks_for_one_again(training: Training) -> None:
    """A run that was launched with `--gpu` continues with a GPU, also without the option."""
    run = training.other("gpu")
    run.run_dir.mkdir(parents=True)
    (run.run_dir / "config.toml").write_text('device = "gpu"\n')
    printed = run.launch("--dry-run")
    learner = next(line for line in printed.splitlines() if line.startswith("+ sbatch"))
    assert "--gres=gpu:1" in learner, learner


def mistakes_are_explained(training: Training) -> None:
    """A mistake exits with a code and a hint, and submits nothing."""
    run = training.other("mistakes")
    launch = ["launch", "--binary", str(run.binary)]
    for options, code, hint in [
        ([*launch, "--actors", "none"], 2, "valid is a number"),
        ([*launch, "--actor", "8"], 2, "is no option"),
        ([*launch, "--actor-cpus", "node", "--hetjob"], 2, "give --actor-cpus a number"),
        ([*launch, "--port", "0"], 2, "valid is a port from 1 to 65535"),
        ([*launch, "--port", "7-6"], 2, "or FIRST-LAST"),
        ([*launch, "--run", "My Run"], 2, "valid are 1 to 64 characters"),
        ([*launch, "--preset", "quick"], 64, "nothing was submitted"),
        (["launch", "--binary", "/nowhere"], 64, "no program at /nowhere"),
        ([*launch, "--preset", "smoke", "--partition", "nowhere"], 1, "invalid partition"),
        (["status"], 1, "holds no run"),
        (["stop"], 1, "holds no run"),
        (["begin"], 2, "none of launch, status, stop"),
    ]:
        found, printed = run.attempt(*options)
        assert (found, hint in printed) == (code, True), f"{COMMAND.name} {options}: {found}, {printed}"


def a_learner_that_cannot_work_frees_the_actors(training: Training) -> None:
    """A learner job that cannot recover fails at once, prints the reason, and cancels the actors."""
    run = training.other("unreachable")
    run.launch("--preset", "smoke", "--actors", "2", "--learner-cpus", "2", "--interface", "nowhere0", *PARTITIONS)
    job, actors = run.learner_job(), run.actor_job()
    until("the learner's job has failed", 40, lambda: queue.state(job) == "FAILED")
    assert "nowhere0 has no IPv4 address" in run.learner_log(), run.learner_log()
    until("the actors' jobs are gone", 40, lambda: not queue.is_queued(actors))


def a_hetjob_trains(run: Training) -> None:
    """Learner and actors start together, only the learner gets the GPU, and all end when the steps are reached."""
    queue.cancel_all()
    task = ["--preset", "smoke", "--steps", "4096", "--actors", "2", "--hetjob", "--no-evaluator"]
    place = ["--learner-cpus", "2", "--interface", "eth0", "--learner-sbatch=--gres=gpu:1", "--partition", conf.LEARNERS]
    printed = run.launch(*task, *place)
    assert printed.count("+ sbatch") == 1, printed
    job = run.learner_job()
    run.wait("the actors work", 60, lambda: len(run.actors_that_work()) == 2)
    for role, has_gpu in (("learner", True), ("actor", False)):
        process = next(iter(run.processes(role)))
        assert (b"CUDA_VISIBLE_DEVICES=" in (process / "environ").read_bytes()) == has_gpu, role
    endpoint = run.endpoint()
    assert endpoint is not None and endpoint.startswith("quic/10."), endpoint
    queue.slurm("scontrol", "requeue", job)
    until("the learner saved", 60, lambda: "ended by term; saved at" in run.learner_log())
    until("the actors work again", 60, lambda: len(run.actors_that_work()) == 2 and run.endpoint() != endpoint)
    run.wait("the run is finished", 180, run.is_finished)
    until("the job is over", 60, lambda: not queue.is_queued(job))
    assert queue.state(job) == "COMPLETED"
    assert run.n_saved_steps() >= 4096
    until("no actor is left", 20, lambda: not run.actors_that_work())


CHECKS: list[Check] = [
    a_rehearsal_changes_nothing,
    a_launch_fits_into_the_queue,
    whole_nodes_take_one_actor_each,
    a_run_on_a_gpu_asks_for_one_again,
    mistakes_are_explained,
    a_learner_that_cannot_work_frees_the_actors,
    a_hetjob_trains,
]

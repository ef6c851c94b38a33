"""Runs one training through preemption, lost nodes, requeues, time limits, and a stop."""

from __future__ import annotations

import stat
import tomllib

import conf
import queue_of_slurm as queue
from training import N_ACTORS, Check, Training
from wait import Watch, in_background, timed, wait_for

ENOUGH = 0.9
"""Success rate at which the task of `near-goal` is learned."""

CLEARLY_ENOUGH = 0.95
"""Success rate of greedy actions at which training may end."""

SETTLED = 0.85
"""Success rate of sampled actions at which it ends. Before that, an update can still undo what greedy actions do well."""


def launch_finds_each_other(training: Training) -> None:
    """One command creates keys and starts the learner and the actors, which find each other."""
    run = training.run
    printed = run.launch(*training.options())
    assert "keys new" in printed and printed.count("+ sbatch") == 2, printed
    training.figures["launch to the first update, s"] = timed("an update", lambda: run.n_steps() > 0, 120, run.check)
    training.wait_for_all_actors(30)
    keys = run.folder / "keys"
    open_to_others = [path for path in [keys, *keys.rglob("*")] if path.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO)]
    assert not open_to_others, open_to_others
    assert len({actor.rsplit("-", 1)[-1] for actor in run.actors_that_work()}) == N_ACTORS
    settings = tomllib.loads((run.folder / "run" / "config.toml").read_text(encoding="utf-8"))
    assert settings["learner"]["checkpoints"]["every_updates"] == 2, "the environment of launch did not reach the learner"
    shown = run.status()
    assert f"{N_ACTORS} RUNNING" in shown and "connected" in shown, shown
    code, printed = run.attempt("launch", "--binary", str(run.binary), *training.options())
    assert code == 1 and "already" in printed, printed


def preempted_actors_return(training: Training) -> None:
    """Urgent work preempts actors, which go back to PENDING and return when it is done."""
    run = training.run
    before = queue.running(run.actor_job())
    node = max(set(before.values()) - {training.learner_node()}, key=list(before.values()).count)
    victims = [task for task, where in before.items() if where == node]
    assert victims, before
    urgent = queue.slurm(
        "sbatch", "--parsable", "-p", conf.URGENT, "-w", node, "--exclusive", "-o", "/dev/null", "--wrap", "sleep 300"
    ).strip()
    wait_for("urgent work runs", lambda: queue.state(urgent) == "RUNNING", 40)
    states = queue.tasks(run.actor_job())
    assert all(states[task][0] in ("PENDING", "COMPLETING") for task in victims), states
    steps = run.n_steps()
    run.wait_for_steps(steps, 90)
    queue.slurm("scancel", urgent)
    training.figures["urgent work gone to all actors working, s"] = timed(
        "all actors work again", lambda: training.n_running() == N_ACTORS, 60
    )
    training.wait_for_all_actors(30)
    assert all(queue.restarts(task) == 1 for task in victims)


def a_cut_node_is_replaced(training: Training) -> None:
    """A node without network is detected, its actors move to another node, and training continues."""
    run, cluster = training.run, training.cluster
    node = next(node for node in queue.running(run.actor_job()).values() if node != training.learner_node())
    cluster.cut(node)
    training.figures["cut node marked down, s"] = timed("the node is down", lambda: queue.node_is_down(node), 60)
    # Slurm drains a node that returns while its old tasks are restarted on it, so let the tasks move first.
    training.figures["cut node's actor working elsewhere, s"] = timed(
        "the actors work elsewhere", lambda: training.n_running() == N_ACTORS, 60
    )
    run.wait_for_steps(run.n_steps(), 90)
    cluster.mend(node)
    # The next check does not need the node.
    training.returning = in_background("the node is back", lambda: queue.node_works(node), 60)


def a_requeued_learner_goes_on(training: Training) -> None:
    """`scontrol requeue` sends SIGTERM to all processes of the job. The learner saves, then resumes from the save."""
    run = training.run
    endpoint = run.endpoint()
    queue.slurm("scontrol", "requeue", run.learner_job())
    with Watch() as watch:
        wait_for("the learner saved", lambda: "ended by term; saved at" in run.learner_log(), 60)
        lines, saved = len(run.metrics("learner")), run.n_saved_steps()
        assert saved >= run.n_steps()
        wait_for("the learner steps again", lambda: len(run.metrics("learner")) > lines, 120, run.check)
    training.figures["learner requeued to its next update, s"] = watch.seconds
    assert run.metrics("learner")[lines]["n_env_steps"] > saved
    assert run.endpoint() not in (None, endpoint)
    training.wait_for_all_actors(60)


def the_mended_node_returns(training: Training) -> None:
    """Slurm puts the node that was cut off back into use automatically."""
    assert training.returning is not None
    training.figures["mended node in use again, s"] = training.returning.result()
    training.wait_for_all_actors(60)


def the_learner_survives_its_node(training: Training) -> None:
    """The learner's node loses power. Another resumes from the newest checkpoint, and the actors reconnect to it."""
    run, cluster = training.run, training.cluster
    job, node, endpoint = run.learner_job(), training.learner_node(), run.endpoint()
    saved = wait_for("a checkpoint", run.n_saved_steps, 60)
    cluster.power_off(node)
    lines = len(run.metrics("learner"))
    with Watch() as watch:
        wait_for("the learner steps elsewhere", lambda: len(run.metrics("learner")) > lines, 120, run.check)
    training.figures["learner's node without power to the next update elsewhere, s"] = watch.seconds
    assert training.learner_node() != node
    assert run.endpoint() != endpoint
    first = run.metrics("learner")[lines]["n_env_steps"]
    assert first > saved, f"began again at {first} steps, {saved} were saved"
    cluster.power_on(node)
    wait_for("the node is back", lambda: queue.node_works(node), 60)
    assert queue.state(job) == "RUNNING"
    training.wait_for_all_actors(60)


def a_cut_learner_lets_go(training: Training) -> None:
    """The learner's node is cut off but keeps running. Its learner exits when another node takes over the run."""
    run, cluster = training.run, training.cluster
    node = training.learner_node()
    cluster.cut(node)
    with Watch() as watch:
        wait_for("the cut learner ends", lambda: "ended by fenced" in run.learner_log(), 90)
        lines, saved = len(run.metrics("learner")), run.n_saved_steps()
        wait_for("the learner steps elsewhere", lambda: len(run.metrics("learner")) > lines, 120, run.check)
    training.figures["learner's node cut off to the next update elsewhere, s"] = watch.seconds
    assert run.metrics("learner")[lines]["n_env_steps"] > saved
    assert training.learner_node() != node
    # The node returns while the run continues. Another check covers how a node returns.
    cluster.mend(node)


def stop_saves(training: Training) -> None:
    """`stop` leaves a complete checkpoint with all steps, and no job that would block the next launch."""
    run = training.run
    job, actors, steps = run.learner_job(), run.actor_job(), run.n_steps()
    printed = run.stop()
    saved = run.n_saved_steps()
    assert saved >= steps and str(saved) in printed, printed
    assert queue.state(job) == "COMPLETED"
    assert not queue.is_queued(actors), "the run cannot be launched again"
    # Actors on a node that was cut off may remain until it is back.
    wait_for("the actors are gone", lambda: not run.actors_that_work(), 40)
    assert run.judged() >= 0.0


def a_time_limit_is_no_end(training: Training) -> None:
    """Jobs with a time limit of one minute save before it, requeue, and resume."""
    run = training.run
    if queue.is_queued(run.learner_job()):
        run.stop()
    before = run.n_saved_steps()
    limits = ["--time", "1", "--save-lead", "5", "--actor-sbatch=--signal=B:USR1@5"]
    run.launch(*training.options(), *limits)
    job = run.learner_job()
    wait_for("the learner is back in the queue", lambda: queue.restarts(job) == 1, 100, run.check)
    lines, saved = len(run.metrics("learner")), run.n_saved_steps()
    assert "no time is left; saved at" in run.learner_log()
    assert saved > before and saved >= run.n_steps(), (before, saved)
    wait_for("the learner steps again", lambda: len(run.metrics("learner")) > lines, 120, run.check)
    assert run.metrics("learner")[lines]["n_env_steps"] > saved
    task = f"{run.actor_job()}_0"
    wait_for("an actor is back in the queue", lambda: queue.restarts(task) >= 1, 100)
    log = run.folder / "logs" / f"actors-{run.actor_job()}-0.log"
    assert "has no time left and goes back into the queue" in log.read_text(encoding="utf-8")


def success_is_reached(training: Training) -> None:
    """The run learns its task. No job is left when its steps are reached."""
    run = training.run
    for job in (run.learner_job(), run.actor_job()):
        queue.slurm("scontrol", "update", f"JobId={job}", "TimeLimit=60")

    def has_learned() -> bool:
        # Two passes, so that the checkpoint a few updates later does not pass or fail by chance over 40 episodes.
        return run.success(n_passes=2) >= CLEARLY_ENOUGH and run.sampled_success() >= SETTLED

    wait_for("learner and evaluator see success", has_learned, 400, run.check)
    assert "greedy actions, after" in run.status(), run.status()
    training.figures["steps to success"] = run.n_steps()
    run.stop()
    run.launch(*training.options(n_steps=run.n_saved_steps() + 1))
    wait_for("the run is finished", run.is_finished, 120, run.check)
    jobs = [run.learner_job(), run.actor_job()]
    wait_for("no job is left", lambda: not any(map(queue.is_queued, jobs)) and not run.actors_that_work(), 60)
    assert queue.state(jobs[0]) == "COMPLETED"
    rate = run.judged()
    training.figures["success of the last checkpoint"] = rate
    assert rate >= ENOUGH, rate


CHECKS: list[Check] = [
    launch_finds_each_other,
    preempted_actors_return,
    a_cut_node_is_replaced,
    a_requeued_learner_goes_on,
    the_mended_node_returns,
    the_learner_survives_its_node,
    a_cut_learner_lets_go,
    stop_saves,
    a_time_limit_is_no_end,
    success_is_reached,
]

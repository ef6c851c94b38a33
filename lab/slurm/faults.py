"""Runs one training through preemption, lost nodes, requeues, time limits, and a stop."""

import stat
import tomllib
from concurrent.futures import ThreadPoolExecutor

from ..ring.checks import until
from . import conf, queue
from .training import N_ACTORS, Check, Training

ENOUGH = 0.9
"""Success rate at which the task of `smoke` is learned."""

CLEARLY_ENOUGH = 0.95
"""Success rate of sampled actions at which training ends."""


def launch_finds_each_other(run: Training) -> None:
    """One command creates keys and starts the learner and the actors, which find each other."""
    printed = run.launch(*run.options())
    assert "keys new" in printed and printed.count("+ sbatch") == 2, printed
    run.wait("an update", 120, lambda: run.n_steps() > 0)
    run.wait_for_all_actors(30)
    keys = run.folder / "keys"
    open_to_others = [path for path in [keys, *keys.rglob("*")] if path.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO)]
    assert not open_to_others, open_to_others
    assert len({actor.rsplit("-", 1)[-1] for actor in run.actors_that_work()}) == N_ACTORS
    settings = tomllib.loads((run.run_dir / "config.toml").read_text())
    assert settings["learner"]["checkpoints"]["every_updates"] == 2, "the environment of launch did not reach the learner"
    shown = run.command("status")
    assert f"{N_ACTORS} RUNNING" in shown and "connected" in shown, shown
    code, printed = run.attempt("launch", "--binary", str(run.binary), *run.options())
    assert code == 1 and "already" in printed, printed


def preempted_actors_return(run: Training) -> None:
    """Urgent work preempts actors, which go back to PENDING and return when it is done."""
    before = queue.running(run.actor_job())
    node = max(set(before.values()) - {run.learner_node()}, key=list(before.values()).count)
    victims = [task for task, where in before.items() if where == node]
    assert victims, before
    there = ["-p", conf.URGENT, "-w", node, "--exclusive", "-o", "/dev/null"]
    urgent = queue.slurm("sbatch", "--parsable", *there, "--wrap", "sleep 300").strip()
    until("urgent work runs", 40, lambda: queue.state(urgent) == "RUNNING")
    states = queue.tasks(run.actor_job())
    assert all(states[task][0] in ("PENDING", "COMPLETING") for task in victims), states
    run.wait_for_steps()
    queue.slurm("scancel", urgent)
    until("all actors work again", 60, run.all_run)
    run.wait_for_all_actors(30)
    assert all(queue.restarts(task) == 1 for task in victims)


def a_cut_node_is_replaced(run: Training) -> None:
    """A node without network is detected, its actors move to another node, and training continues."""
    node = next(node for node in queue.running(run.actor_job()).values() if node != run.learner_node())
    run.cluster.cut(node)
    until("the node is down", 60, lambda: queue.node_is_down(node))
    # Slurm drains a node that returns while its old tasks are restarted on it, so let the tasks move first.
    until("the actors work elsewhere", 60, run.all_run)
    run.wait_for_steps()
    run.cluster.mend(node)
    # The next check does not need the node.
    run.returning = ThreadPoolExecutor(1).submit(until, "the node is back", 60, lambda: queue.node_works(node))


def a_requeued_learner_goes_on(run: Training) -> None:
    """`scontrol requeue` sends SIGTERM to all processes of the job. The learner saves, then resumes from the save."""
    endpoint = run.endpoint()
    queue.slurm("scontrol", "requeue", run.learner_job())
    until("the learner saved", 60, lambda: "ended by term; saved at" in run.learner_log())
    assert run.n_saved_steps() >= run.n_steps()
    run.wait_for_steps_beyond(run.n_saved_steps())
    assert run.endpoint() not in (None, endpoint)
    run.wait_for_all_actors(60)


def the_mended_node_returns(run: Training) -> None:
    """Slurm puts the node that was cut off back into use automatically."""
    assert run.returning is not None
    run.returning.result()
    run.wait_for_all_actors(60)


def the_learner_survives_its_node(run: Training) -> None:
    """The learner's node loses power. Another resumes from the newest checkpoint, and the actors reconnect to it."""
    job, node, endpoint = run.learner_job(), run.learner_node(), run.endpoint()
    saved = until("a checkpoint", 60, run.n_saved_steps)
    run.cluster.power_off(node)
    run.wait_for_steps_beyond(saved)
    assert run.learner_node() != node
    assert run.endpoint() != endpoint
    run.cluster.power_on(node)
    until("the node is back", 60, lambda: queue.node_works(node))
    assert queue.state(job) == "RUNNING"
    run.wait_for_all_actors(60)


def a_cut_learner_lets_go(run: Training) -> None:
    """The learner's node is cut off but keeps running. Its learner exits when another node takes over the run."""
    node = run.learner_node()
    run.cluster.cut(node)
    until("the cut learner ends", 90, lambda: "ended by fenced" in run.learner_log())
    run.wait_for_steps_beyond(run.n_saved_steps())
    assert run.learner_node() != node
    # The node returns while the run continues. Another check covers how a node returns.
    run.cluster.mend(node)


def stop_saves(run: Training) -> None:
    """`stop` leaves a complete checkpoint with all steps, and no job that would block the next launch."""
    job, actors, steps = run.learner_job(), run.actor_job(), run.n_steps()
    printed = run.stop()
    saved = run.n_saved_steps()
    assert saved >= steps and str(saved) in printed, printed
    assert queue.state(job) == "COMPLETED"
    assert not queue.is_queued(actors), "the run cannot be launched again"
    # Actors on a node that was cut off may remain until it is back.
    until("the actors are gone", 40, lambda: not run.actors_that_work())
    assert run.evaluated() >= 0.0


def a_time_limit_is_no_end(run: Training) -> None:
    """Jobs with a time limit of one minute save before it, requeue, and resume."""
    if queue.is_queued(run.learner_job()):
        run.stop()
    before = run.n_saved_steps()
    run.launch(*run.options(), "--time", "1", "--save-lead", "5", "--actor-sbatch=--signal=B:USR1@5")
    job = run.learner_job()
    run.wait("the learner is back in the queue", 100, lambda: queue.restarts(job) == 1)
    saved = run.n_saved_steps()
    assert "no time is left; saved at" in run.learner_log()
    assert saved > before and saved >= run.n_steps(), (before, saved)
    run.wait_for_steps_beyond(saved)
    task = f"{run.actor_job()}_0"
    until("an actor is back in the queue", 100, lambda: queue.restarts(task) >= 1)
    log = run.folder / "logs" / f"actors-{run.actor_job()}-0.log"
    assert "has no time left and goes back into the queue" in log.read_text()


def success_is_reached(run: Training) -> None:
    """The run learns its task. No job is left when its steps are reached."""
    for job in (run.learner_job(), run.actor_job()):
        queue.slurm("scontrol", "update", f"JobId={job}", "TimeLimit=60")

    def has_learned() -> bool:
        # Two evaluations, so that the checkpoint a few updates later does not pass or fail by chance over 40 episodes.
        return run.success(n_evaluations=2) >= CLEARLY_ENOUGH

    run.wait("learner and evaluator see success", 400, has_learned)
    shown = run.command("status")
    assert "greedy actions, after" in shown, shown
    run.stop()
    run.launch(*run.options(n_steps=run.n_saved_steps() + 1))
    run.wait("the run is finished", 120, run.is_finished)
    jobs = [run.learner_job(), run.actor_job()]
    until("no job is left", 60, lambda: not any(map(queue.is_queued, jobs)) and not run.actors_that_work())
    assert queue.state(jobs[0]) == "COMPLETED"
    rate = run.evaluated()
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

"""Compares the counters at both ends of the bus.

An actor reports every 2 s how many trajectories were acknowledged. A learner writes a line after each update with
how many it took. Counts since the last report are lost when a process is killed, so each bound below allows for exactly
that.
"""

from ..ring.checks import require
from ..ring.records import Life, updates_add_up
from .reports import ActorLife
from .ring import BACKLOG, N_ACTORS, N_OUTSTANDING, N_WORLDS, SEGMENT_LEN, Ring

# Attempts to send a trajectory that is not answered.
N_ATTEMPTS = 3


def steps_add_up(lives: list[Life]) -> str:
    """Checks that no step is lost within a process, and that each process resumes from the newest checkpoint."""
    counted = updates_add_up(lives)
    for number, life in enumerate(lives, 1):
        if life.updates:
            found, expected = life.began_with, life.saved_steps_before
            require(found == expected, f"process {number} began with {found} steps, the checkpoint had {expected}")
    most_again = 0
    for life, successor in zip(lives, lives[1:]):
        require(successor.saved_steps_before >= life.saved_steps_before, "the newest checkpoint went back")
        again = life.ended_with - life.saved_steps_after
        require(again <= 0 or life.killed, f"{again} steps were lost though the learner ended by SIGTERM")
        most_again = max(most_again, again)
    return f"{counted}, at most {most_again} steps trained again after a kill"


def segments_add_up(life: ActorLife) -> None:
    """Checks that each segment of steps is acknowledged, dropped for one reason, or still pending.

    A segment has 16 steps, or fewer if it ends an episode, so there are at most steps / 16 + episodes segments. Every
    step is in a segment, except for those in unfinished segments and diverged episodes.
    """
    report = life.last
    known = life.n_acked + life.n_dropped
    n_steps, n_episodes = report["n_env_steps"], report["n_episodes"]
    n_diverged = report["dropped"]["diverged_total"]
    # The thread counts a round of all worlds after it hands over their segments.
    at_most = n_steps / SEGMENT_LEN + n_episodes + N_WORLDS
    at_least = (n_steps - (N_WORLDS + n_diverged) * SEGMENT_LEN) / SEGMENT_LEN - BACKLOG - N_OUTSTANDING
    account = f"{life.n_acked} acknowledged and {report['dropped']} of {n_steps} steps in {n_episodes} episodes"
    require(at_least <= known <= at_most, f"{life.actor} of {life.epoch_ms}: {account}")
    require(not life.going_back, "; ".join(life.going_back))


def actors_add_up(ring: Ring) -> str:
    """Applies `segments_add_up` to every actor process that has reported."""
    reports = ring.reports
    require(not reports.wrong, "; ".join(reports.wrong[:3]))
    for life in reports.actors.values():
        segments_add_up(life)
    n_acked = sum(life.n_acked for life in reports.actors.values())
    n_dropped = sum(life.n_dropped for life in reports.actors.values())
    n_lives = sum(len(actor.processes) for actor in ring.actors)
    return f"{n_acked} acknowledged and {n_dropped} dropped by {len(reports.actors)} of {n_lives} processes that reported"


def taken_between(life: Life) -> list[int]:
    """Returns how many trajectories a learner took from each line to the next."""
    taken = [0] + [u["ingest"]["accepted_total"] + u["ingest"]["duplicates_total"] for u in life.updates]
    return [after - before for before, after in zip(taken, taken[1:])]


def lost_with(life: Life) -> int:
    """Returns the number of trajectories that a learner accepted, by its last line, but that are in no checkpoint.

    The number is negative if the last checkpoint came after the last line.
    """
    n_saved = life.saved_accepted_after - life.saved_accepted_before
    return life.ingest.get("accepted_total", 0) - n_saved


def both_ends_agree(ring: Ring, n_faults: int) -> str:
    """Checks that acknowledged trajectories were taken, and that taken trajectories were acknowledged.

    After its last line, a learner takes fewer trajectories than between two lines, or the next line would exist. Twice
    that number is allowed because stale trajectories in the mailbox make room. The same holds for actors and reports.
    Answers are lost only in an incident: at most one per attempt for each trajectory in flight.
    """
    learners, actors = ring.learner_lives, ring.reports.actors.values()
    most_between_lines = max((between for life in learners for between in taken_between(life)), default=0)
    most_between_reports = max((life.most_acked_between for life in actors), default=0)
    n_acked, n_taken = sum(life.n_acked for life in actors), sum(life.n_taken for life in learners)
    acked_unrecorded = 2 * most_between_reports * sum(len(actor.processes) for actor in ring.actors)
    taken_unrecorded = 2 * most_between_lines * len(learners)
    # Each fault may have cost answers, and so may the start, the stops in between, and the end.
    answers_lost = N_ATTEMPTS * N_OUTSTANDING * N_ACTORS * (n_faults + 3)
    lost_with_kills = sum(max(0, lost_with(life)) for life in learners if life.killed)
    sums = (
        f"{n_acked} acknowledged (unrecorded at most {acked_unrecorded}), {n_taken} taken (unrecorded at most "
        f"{taken_unrecorded}), answers lost at most {answers_lost}; at least {lost_with_kills} taken after a checkpoint "
        "and lost with a kill, as documented"
    )
    require(n_acked <= n_taken + taken_unrecorded, f"more acknowledged than taken: {sums}")
    require(n_taken <= n_acked + acked_unrecorded + answers_lost, f"more taken than acknowledged: {sums}")
    return sums


def clean_ends_save_all(lives: list[Life]) -> str:
    """Checks that a learner that ended by SIGTERM has everything in its checkpoint that its lines report."""
    ended_well = [life for life in lives if not life.killed]
    for life in ended_well:
        require(lost_with(life) <= 0, f"{lost_with(life)} accepted trajectories are in no checkpoint: {life.ingest}")
    return f"{len(ended_well)} processes"

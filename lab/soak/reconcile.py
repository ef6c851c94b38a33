"""Compares the counters at both ends of the bus.

An actor reports every 2 s how many trajectories were acknowledged. A learner writes a line after each update with
how many it took. Counts since the last report are lost when a process is killed, so each bound below allows for exactly
that.
"""

from __future__ import annotations

from dataclasses import dataclass

from bus import ActorLife, Listener
from checks import require
from members import Member
from records import LearnerLife
from ring import BACKLOG, INGEST_QUEUE, N_ACTORS, N_OUTSTANDING, N_WORLDS, SEGMENT_LEN

# Attempts to send a trajectory that is not answered.
N_ATTEMPTS = 3


def verdicts_add_up(lives: list[LearnerLife]) -> str:
    """Checks that each received trajectory has one verdict, except for those in the queue before the decoder."""
    n_received = most_waiting = 0
    for number, life in enumerate(lives, 1):
        for update in life.updates:
            ingest: dict[str, int] = update["ingest"]
            waiting = 2 * ingest["received_total"] - sum(ingest.values())
            # The counts are read one at a time, and a verdict may happen in between.
            require(-N_ACTORS * N_OUTSTANDING <= waiting <= INGEST_QUEUE, f"process {number}: {waiting} wait in {ingest}")
            most_waiting = max(most_waiting, waiting)
        n_received += life.ingest.get("received_total", 0)
    return f"{n_received} arrived at {len(lives)} processes, at most {most_waiting} had no verdict yet"


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


def actors_add_up(listener: Listener, actors: list[Member]) -> str:
    """Applies `segments_add_up` to every actor process that has reported."""
    require(not listener.wrong, "; ".join(listener.wrong[:3]))
    for life in listener.actors.values():
        segments_add_up(life)
    n_acked = sum(life.n_acked for life in listener.actors.values())
    n_dropped = sum(life.n_dropped for life in listener.actors.values())
    n_lives = sum(len(actor.lives) for actor in actors)
    return f"{n_acked} acknowledged and {n_dropped} dropped by {len(listener.actors)} of {n_lives} processes that reported"


@dataclass
class Balance:
    """Totals of both ends, and bounds on what may have been lost unrecorded."""

    n_acked: int
    """By the last reports of all processes of actors."""
    n_taken: int
    """By the last lines of all processes of the learner: accepted, and repeats of what was accepted."""
    n_acked_unrecorded: int
    n_taken_unrecorded: int
    n_answers_lost: int
    n_lost_after_a_checkpoint: int
    """Taken by learners that were killed, and not in the checkpoint that the next one began with."""

    def __str__(self) -> str:
        return (
            f"{self.n_acked} acknowledged at the actors (unrecorded at most {self.n_acked_unrecorded}), {self.n_taken} taken by the "
            f"learner (unrecorded at most {self.n_taken_unrecorded}), answers lost at most {self.n_answers_lost}; "
            f"at least {self.n_lost_after_a_checkpoint} taken after a checkpoint and lost with a kill, as documented"
        )


def balance(learners: list[LearnerLife], listener: Listener, actors: list[Member], n_incidents: int) -> Balance:
    """Sums up both ends. `n_incidents` counts the faults that may have cost an answer."""
    lives = list(listener.actors.values())
    most_between_lines = max((between for life in learners for between in taken_between(life)), default=0)
    most_between_reports = max((life.most_acked_between for life in lives), default=0)
    killed = [life for life in learners if life.killed]
    return Balance(
        n_acked=sum(life.n_acked for life in lives),
        n_taken=sum(life.n_taken for life in learners),
        n_acked_unrecorded=2 * most_between_reports * sum(len(actor.lives) for actor in actors),
        n_taken_unrecorded=2 * most_between_lines * len(learners),
        n_answers_lost=N_ATTEMPTS * N_OUTSTANDING * N_ACTORS * n_incidents,
        n_lost_after_a_checkpoint=sum(max(0, lost_with(life)) for life in killed),
    )


def taken_between(life: LearnerLife) -> list[int]:
    """Returns how many trajectories a learner took from each line to the next."""
    taken = [0] + [u["ingest"]["accepted_total"] + u["ingest"]["duplicates_total"] for u in life.updates]
    return [after - before for before, after in zip(taken, taken[1:])]


def lost_with(life: LearnerLife) -> int:
    """Returns the number of trajectories that a learner accepted, by its last line, but that are in no checkpoint.

    The number is negative if the last checkpoint came after the last line.
    """
    n_saved = life.saved_accepted_after - life.saved_accepted_before
    return life.ingest.get("accepted_total", 0) - n_saved


def both_ends_agree(sums: Balance) -> str:
    """Checks that acknowledged trajectories were taken, and that taken trajectories were acknowledged.

    After its last line, a learner takes fewer trajectories than between two lines, or the next line would exist. Twice
    that number is allowed because stale trajectories in the mailbox make room. The same holds for actors and reports.
    Answers are lost only in an incident: at most one per attempt for each trajectory in flight.
    """
    require(sums.n_acked <= sums.n_taken + sums.n_taken_unrecorded, f"more acknowledged than taken: {sums}")
    limit = sums.n_acked + sums.n_acked_unrecorded + sums.n_answers_lost
    require(sums.n_taken <= limit, f"more taken than acknowledged: {sums}")
    return str(sums)


def clean_ends_save_all(lives: list[LearnerLife]) -> str:
    """Checks that a learner that ended by SIGTERM has everything in its checkpoint that its lines report."""
    ended_well = [life for life in lives if not life.killed]
    for life in ended_well:
        require(lost_with(life) <= 0, f"{lost_with(life)} accepted trajectories are in no checkpoint: {life.ingest}")
    return f"{len(ended_well)} processes"

"""Checks after the faults: all members work again, and an undisturbed learner accounts for every trajectory."""

import asyncio

from ..ring import records
from ..ring.checks import eventually, require
from .ring import BACK_S, N_ACTORS, N_OUTSTANDING, Ring

N_UPDATES = 10


async def all_work(ring: Ring) -> str:
    """Waits until every actor has more trajectories acknowledged, the learner saves, and the evaluator reports."""
    acked = {actor.name: ring.acked(actor) for actor in ring.actors}
    steps, n_summaries = records.saved_steps(ring.run_dir), ring.reports.n_summaries

    def all_have_more() -> bool:
        return all(ring.acked(actor) > acked[actor.name] for actor in ring.actors)

    await eventually("all actors have more acknowledged", BACK_S, all_have_more)
    await eventually("a newer checkpoint", BACK_S, lambda: records.saved_steps(ring.run_dir) > steps)
    await eventually("an evaluation", 3 * BACK_S, lambda: ring.reports.n_summaries > n_summaries)
    return f"{N_ACTORS} actors, learner and evaluator"


async def calm(ring: Ring, seconds: float) -> str:
    """Lets the ring run without faults for a while and records its memory."""
    n_updates = ring.n_updates()
    ring.memory.is_calm = True
    await asyncio.sleep(seconds)
    ring.memory.is_calm = False
    require(ring.n_updates() > n_updates, "the learner did nothing")
    return f"{seconds:.0f} s, {ring.n_updates() - n_updates} updates"


async def acked_and_saved_at_rest(ring: Ring) -> tuple[int, int]:
    """Stops the learner. Returns what the actors know as acknowledged once all have noticed, and what it saved."""
    await ring.stop_learner()
    for actor in ring.actors:
        # The first report received after the learner's exit may predate it.
        before = ring.report(actor)
        n_before = before.n_reports if before else 0

        def has_said_so() -> bool:
            now = ring.report(actor)
            return bool(now and now.n_reports >= n_before + 2 and not now.last["learner_is_there"])

        await eventually(f"{actor.name} says that the learner is gone", BACK_S, has_said_so)
    return sum(map(ring.acked, ring.actors)), records.newest_checkpoint(ring.run_dir)[1]


async def nothing_is_lost(ring: Ring) -> str:
    """Checks that everything a learner acknowledges between its start and SIGTERM is in its last checkpoint."""
    acked_before, saved_before = await acked_and_saved_at_rest(ring)
    ring.resume_learner()
    n_updates = ring.n_updates()
    await eventually("updates without a fault", 2 * BACK_S, lambda: ring.n_updates() >= n_updates + N_UPDATES)
    acked_after, saved_after = await acked_and_saved_at_rest(ring)
    ring.resume_learner()
    # A process that has just begun does not handle SIGTERM yet.
    await eventually("the learner takes trajectories again", BACK_S, ring.learner_has_taken)
    acked, saved = acked_after - acked_before, saved_after - saved_before
    said = f"{acked} acknowledged, {saved} in the checkpoint"
    require(acked <= saved, f"{acked - saved} acknowledged trajectories were lost by a learner that ended well: {said}")
    # The last answers may not have arrived before the learner exited.
    require(saved - acked <= N_ACTORS * N_OUTSTANDING, f"answers are missing: {said}")
    return said

"""Checks after the faults: all members work again, and an undisturbed learner accounts for every trajectory."""

from __future__ import annotations

import asyncio

import records
from checks import require, until
from members import Member
from ring import BACK_S, N_ACTORS, N_OUTSTANDING, Ring

N_UPDATES = 10


async def all_work(ring: Ring) -> str:
    """Waits until every actor has more trajectories acknowledged, the learner saves, and the evaluator reports."""
    acked = {actor.name: ring.acked(actor) for actor in ring.actors}
    steps, _ = records.newest_checkpoint(ring.run_dir)
    n_summaries = ring.listener.n_summaries

    def all_have_more() -> bool:
        return all(ring.acked(actor) > acked[actor.name] for actor in ring.actors)

    await until("all actors have more acknowledged", BACK_S, all_have_more)
    await until("a newer checkpoint", BACK_S, lambda: records.newest_checkpoint(ring.run_dir)[0] > steps)
    await until("an evaluation", 3 * BACK_S, lambda: ring.listener.n_summaries > n_summaries)
    return f"{N_ACTORS} actors, learner and evaluator"


async def calm(ring: Ring, seconds: float) -> str:
    """Lets the ring run without faults for a while and records its memory."""
    n_updates = ring.n_updates()
    ring.memory.is_calm = True
    await asyncio.sleep(seconds)
    ring.memory.is_calm = False
    require(ring.n_updates() > n_updates, "the learner did nothing")
    return f"{seconds:.0f} s, {ring.n_updates() - n_updates} updates"


async def _acked_at_rest(ring: Ring) -> int:
    """Returns the actors' acknowledged trajectories once all actors have noticed that the learner is gone."""

    async def at_rest(actor: Member) -> int:
        # The first report received after the learner's exit may predate it.
        before = ring.report(actor)
        n_before = before.n_reports if before else 0

        def has_said_so() -> bool:
            now = ring.report(actor)
            return bool(now and now.n_reports >= n_before + 2 and not now.last["learner_is_there"])

        await until(f"{actor.name} says that the learner is gone", BACK_S, has_said_so)
        return ring.acked(actor)

    return sum([await at_rest(actor) for actor in ring.actors])


async def nothing_is_lost(ring: Ring) -> str:
    """Checks that everything a learner acknowledges between its start and SIGTERM is in its last checkpoint."""
    await ring.stop_learner()
    acked_before, (_, saved_before) = await _acked_at_rest(ring), records.newest_checkpoint(ring.run_dir)
    ring.resume_learner()
    n_updates = ring.n_updates()
    await until("updates without a fault", 2 * BACK_S, lambda: ring.n_updates() >= n_updates + N_UPDATES)
    await ring.stop_learner()
    acked_after, (_, saved_after) = await _acked_at_rest(ring), records.newest_checkpoint(ring.run_dir)
    ring.resume_learner()
    acked, saved = acked_after - acked_before, saved_after - saved_before
    said = f"{acked} acknowledged, {saved} in the checkpoint"
    require(acked <= saved, f"{acked - saved} acknowledged trajectories were lost by a learner that ended well: {said}")
    # The last answers may not have arrived before the learner exited.
    require(saved - acked <= N_ACTORS * N_OUTSTANDING, f"answers are missing: {said}")
    return said

"""Injects random faults from a seed and measures how long the ring takes to recover."""

from __future__ import annotations

import asyncio
import random
import signal
import time
from collections import Counter
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field

import records
from checks import Failed, until
from members import End, Member
from relay import Line
from ring import BACK_S, Ring

# Duration of a stop or a cut, in seconds.
LASTING_S = (0.1, 10.0)

# Pause between two faults, in seconds.
PAUSE_S = (1.0, 5.0)

# How long a kill waits for a save to begin.
PATIENCE_S = 15.0

# Every round injects all of these in a new random order.
DECK = (
    ["kill learner", "kill learner in a save", "kill router", "kill evaluator"]
    + ["kill actor"] * 2
    + ["stop router", "stop learner", "stop actor", "stop evaluator"]
    + ["cut learner", "cut evaluator"]
    + ["cut actor"] * 2
    + ["end router", "end learner", "end actor", "end evaluator"]
)


@dataclass
class Record:
    """Injected faults and their outcomes."""

    injected: Counter[str] = field(default_factory=Counter)
    learner_back_s: list[float] = field(default_factory=list)
    """After each kill -9 of the learner."""
    learner_restart_back_s: list[float] = field(default_factory=list)
    """After each SIGTERM of the learner."""
    router_back_s: list[float] = field(default_factory=list)
    n_kills_in_a_save: int = 0
    failures: list[str] = field(default_factory=list)

    @property
    def n_faults(self) -> int:
        """Total number of injected faults."""
        return self.injected.total()


class Faults:
    """Injects faults into a ring, several at a time as long as enough members keep working."""

    def __init__(self, ring: Ring, seed: int) -> None:
        self.record = Record()
        self._ring = ring
        self._random = random.Random(seed)
        self._deck: list[str] = []
        self._running: set[asyncio.Task[None]] = set()

    async def inject(self, seconds: float, at_least: int) -> None:
        """Injects faults for `seconds` and until there were `at_least`, then waits for the ring to recover."""
        end = time.monotonic() + seconds
        while time.monotonic() < end or self.record.n_faults < at_least:
            begun = self._begin_one()
            low, high = PAUSE_S
            await asyncio.sleep(self._random.uniform(low, high) if begun else 0.1)
        await asyncio.gather(*self._running)

    async def cancel(self) -> None:
        """Cancels the active faults, so that they start no more processes."""
        for task in self._running:
            task.cancel()
        await asyncio.gather(*self._running, return_exceptions=True)

    def _begin_one(self) -> bool:
        """Starts the next possible fault in the deck. Returns False if there is none."""
        if not self._deck:
            self._deck = self._random.sample(DECK, len(DECK))
        for position, name in enumerate(self._deck):
            kind, _, rest = name.partition(" ")
            role, _, moment = rest.partition(" ")
            member = self._choose(role)
            if member is not None:
                del self._deck[position]
                self.record.injected[name] += 1
                member.hurt.add(name)
                task = asyncio.create_task(self._suffer(name, member, self._effect(kind, member, bool(moment))))
                self._running.add(task)
                task.add_done_callback(self._running.discard)
                return True
        return False

    def _choose(self, role: str) -> Member | None:
        """Returns a random member of the role that may be disturbed now, or None.

        Learner and router are never disturbed at the same time, so that a recovery time belongs to one fault. At least
        one actor stays healthy.
        """
        ring = self._ring
        whole = [member for member in ring.members if member.role == role and member.is_whole]
        if role in ("learner", "router") and not (ring.learner.is_whole and ring.router.is_whole):
            return None
        if role in ("learner", "router", "actor"):
            n_working = sum(actor.is_whole for actor in ring.actors)
            if n_working <= (1 if role == "actor" else 0):
                return None
        return self._random.choice(whole) if whole else None

    def _effect(self, kind: str, member: Member, in_a_save: bool) -> Coroutine[None, None, None]:
        seconds = self._random.uniform(*LASTING_S)
        line = self._random.choice([Line.SILENT, Line.RESET])
        if kind == "stop":
            return self._stop(member, seconds)
        if kind == "cut":
            return self._cut(member, line, seconds)
        return self._restart(member, End.KILLED if kind == "kill" else End.TERMINATED, in_a_save)

    async def _suffer(self, name: str, member: Member, effect: Coroutine[None, None, None]) -> None:
        """Runs a fault to completion, including the member's recovery, and records a failure."""
        try:
            await effect
        except Failed as error:
            self.record.failures.append(f"{name} of {member.name}: {error}")
            print(f"FAILED  {name} of {member.name}: {error}", flush=True)
            if member.poll() is not None:
                member.start()
        finally:
            member.hurt.discard(name)

    async def _stop(self, member: Member, seconds: float) -> None:
        member.send(signal.SIGSTOP)
        try:
            await asyncio.sleep(seconds)
        finally:
            member.send(signal.SIGCONT)
        await self._back(member)

    async def _cut(self, member: Member, line: Line, seconds: float) -> None:
        assert member.relay is not None, "everybody but the router has a relay"
        member.relay.cut(line)
        try:
            await asyncio.sleep(seconds)
        finally:
            member.relay.mend()
        await self._back(member)

    async def _restart(self, member: Member, end: End, in_a_save: bool) -> None:
        ring = self._ring
        if in_a_save:
            await self._wait_for_a_save()
        began = time.monotonic()
        if member is ring.learner:
            await ring.restart_learner(end)
            await until("the learner takes trajectories again", BACK_S, ring.learner_has_taken)
            times = self.record.learner_back_s if end is End.KILLED else self.record.learner_restart_back_s
            times.append(time.monotonic() - began)
            return
        await (member.kill() if end is End.KILLED else member.terminate())
        member.start()
        await self._back(member)
        if member is ring.router:
            self.record.router_back_s.append(time.monotonic() - began)

    async def _wait_for_a_save(self) -> None:
        """Returns while a checkpoint is being written, or after `PATIENCE_S`."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            if records.cut_short(self._ring.run_dir):
                self.record.n_kills_in_a_save += 1
                return
            await asyncio.sleep(0.001)

    async def _back(self, member: Member) -> None:
        """Waits until a member works again, as observed by others."""
        ring = self._ring
        if member.role == "actor":
            await until(f"{member.name} has more acknowledged", BACK_S, self._grows(lambda: ring.acked(member)))
        elif member.role in ("learner", "router"):
            await until(f"updates after {member.name} was hurt", BACK_S, self._grows(ring.n_updates))
        else:
            # The evaluator runs only when there are new weights. The final checks cover its evaluations.
            await until(f"{member.name} runs", BACK_S, lambda: time.time() > member.life.began + 1)

    @staticmethod
    def _grows(count: Callable[[], int]) -> Callable[[], bool]:
        """Returns a condition: the count has changed twice. The first change may stem from before the fault."""
        seen = [count()]

        def has_grown() -> bool:
            now = count()
            if now != seen[-1]:
                seen.append(now)
            return len(seen) > 2

        return has_grown

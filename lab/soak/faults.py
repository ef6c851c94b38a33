"""Injects random faults from a seed and measures how long the ring takes to recover."""

import asyncio
import random
import signal
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Coroutine

from ..ring import records
from ..ring.checks import Failed, eventually, require
from .members import Member
from .ring import BACK_S, Ring

# Duration of a stop or a cut, and the pause between two faults, in seconds.
LASTING_S = (0.1, 10.0)
PAUSE_S = (1.0, 5.0)

# How long a kill waits for a save to begin.
PATIENCE_S = 15.0

PROGRESS_S = 10.0

# Every round injects all of these in a new random order.
DECK = (
    ["kill learner", "kill learner in a save", "kill router", "kill evaluator"]
    + ["kill actor"] * 2
    + ["stop router", "stop learner", "stop actor", "stop evaluator"]
    + ["cut learner", "cut evaluator"]
    + ["cut actor"] * 2
    + ["end router", "end learner", "end actor", "end evaluator"]
)


class Faults:
    """Injects faults into a ring, several at a time as long as enough members keep working."""

    def __init__(self, ring: Ring, seed: int) -> None:
        self.injected: Counter[str] = Counter()
        self.n_kills_in_a_save = 0
        self.failures: list[str] = []
        self.back_s: defaultdict[str, list[float]] = defaultdict(list)
        """How long the ring took to work again after each kill and end of learner and router."""
        self._ring = ring
        self._random = random.Random(seed)
        self._deck: list[str] = []
        self._running: set[asyncio.Task[None]] = set()

    @property
    def n_injected(self) -> int:
        """Total number of faults so far."""
        return self.injected.total()

    def were_survived(self) -> str:
        """Fails if somebody did not recover from a fault. Returns the number of faults of each kind."""
        require(not self.failures, "; ".join(self.failures))
        said = ", ".join(f"{n} {name}" for name, n in sorted(self.injected.items()))
        return f"{self.n_injected}: {said}; {self.n_kills_in_a_save} kills hit a save"

    async def inject(self, seconds: float, at_least: int) -> None:
        """Injects faults for `seconds` and until there were `at_least`, then waits for the ring to recover."""
        began = told = time.monotonic()
        while (now := time.monotonic()) < began + seconds or self.n_injected < at_least:
            if now > told + PROGRESS_S:
                told = now
                hurt = sorted(name for member in self._ring.members for name in member.hurt)
                said = f"{self.n_injected} faults, {self._ring.n_updates()} updates, now: {', '.join(hurt) or 'none'}"
                print(f"[{now - began:5.0f} s] {said}", flush=True)
            begun = self._begin_one()
            await asyncio.sleep(self._random.uniform(*PAUSE_S) if begun else 0.1)
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
                self.injected[name] += 1
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
        whole = [member for member in ring.members if member.role == role and not member.hurt]
        if role in ("learner", "router") and (ring.learner.hurt or ring.router.hurt):
            return None
        n_working = sum(not actor.hurt for actor in ring.actors)
        if role != "evaluator" and n_working <= (1 if role == "actor" else 0):
            return None
        return self._random.choice(whole) if whole else None

    def _effect(self, kind: str, member: Member, in_a_save: bool) -> Coroutine[None, None, None]:
        seconds = self._random.uniform(*LASTING_S)
        reset = self._random.choice([False, True])
        if kind == "stop":
            stop, go_on = signal.SIGSTOP, signal.SIGCONT
            return self._pass(member, seconds, lambda: member.process.send(stop), lambda: member.process.send(go_on))
        if kind == "cut":
            relay = member.relay
            assert relay is not None, "everybody but the router has a relay"
            return self._pass(member, seconds, lambda: relay.cut(reset), relay.mend)
        return self._restart(member, kind == "kill", in_a_save)

    async def _suffer(self, name: str, member: Member, effect: Coroutine[None, None, None]) -> None:
        """Runs a fault to completion, including the member's recovery, and records a failure."""
        try:
            await effect
        except Failed as error:
            self.failures.append(f"{name} of {member.name}: {error}")
            print(f"FAILED  {name} of {member.name}: {error}", flush=True)
            if member.has_ended():
                member.start()
        finally:
            member.hurt.discard(name)

    async def _pass(self, member: Member, seconds: float, begin: Callable[[], object], end: Callable[[], object]) -> None:
        """Lets a fault that ends by itself last for `seconds`."""
        begin()
        try:
            await asyncio.sleep(seconds)
        finally:
            end()
        await self._back(member)

    async def _restart(self, member: Member, killed: bool, in_a_save: bool) -> None:
        ring = self._ring
        if in_a_save:
            await self._wait_for_a_save()
        began = time.monotonic()
        if member is ring.learner:
            await ring.restart_learner(killed)
            await eventually("the learner takes trajectories again", BACK_S, ring.learner_has_taken)
        else:
            await (member.kill() if killed else member.terminate())
            member.start()
            await self._back(member)
        if member in (ring.learner, ring.router):
            self.back_s[f"{'kill' if killed else 'end'} {member.name}"].append(time.monotonic() - began)

    async def _wait_for_a_save(self) -> None:
        """Returns while a checkpoint is being written, or after `PATIENCE_S`."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            if records.unfinished(self._ring.run_dir):
                self.n_kills_in_a_save += 1
                return
            await asyncio.sleep(0.001)

    async def _back(self, member: Member) -> None:
        """Waits until a member works again, as observed by others."""
        ring = self._ring
        if member.role == "actor":
            await eventually(f"{member.name} has more acknowledged", BACK_S, grows(lambda: ring.acked(member)))
        elif member.role in ("learner", "router"):
            await eventually(f"updates after {member.name} was hurt", BACK_S, grows(ring.n_updates))
        else:
            # The evaluator runs only when there are new weights. The final checks cover its evaluations.
            await eventually(f"{member.name} joins", BACK_S, lambda: "joined the bus" in member.process.log.read_text(errors="replace"))


def grows(count: Callable[[], int]) -> Callable[[], bool]:
    """Returns a condition: the count has changed twice. The first change may stem from before the fault."""
    seen = [count()]

    def has_grown() -> bool:
        now = count()
        if now != seen[-1]:
            seen.append(now)
        return len(seen) > 2

    return has_grown

"""The ring under test: router, learner, three actors, and evaluator on loopback, with clients behind relays."""

import asyncio
import time
from pathlib import Path

from ..ring import records
from ..ring.bus import listens
from ..ring.checks import eventually
from ..ring.processes import ENDLESS, Word, free_port, settings
from .members import SMALL_UPDATES, Member, supervise
from .memory import Memory
from .relay import Relay
from .reports import ActorLife, Reports

RUN = "soak"
N_ACTORS = 3
SEGMENT_LEN = 16
N_WORLDS = 4
BACKLOG = 16

# As in the program: segments of an actor in flight, and trajectories that wait to be decoded at the learner.
N_OUTSTANDING = 2
INGEST_QUEUE = 256

SETTINGS: dict[str, object] = {
    **SMALL_UPDATES,
    "learner.checkpoints.keep": 5,
    "actor.n_worlds": N_WORLDS,
    "actor.segment_len": SEGMENT_LEN,
    "actor.backlog_limit": BACKLOG,
    "actor.full_backlog": "drop-oldest",
    "evaluator.every.versions": 10,
    "evaluator.episodes.n_episodes": 2,
    "evaluator.videos.groups": [],
}

BACK_S = 60.0


class Ring:
    """All members and what was recorded about them."""

    def __init__(self, binary: Path, folder: Path, seed: int) -> None:
        self.run_dir = folder / "run"
        self.lines = records.Lines(self.run_dir)
        self.learner_lives: list[records.Life] = []
        self.accidents: list[str] = []
        self.memory = Memory()
        self.members: list[Member] = []
        self._logs = folder / "logs"
        self._binary = binary
        self._seed = seed
        self._port = free_port()
        self.reports = Reports(self._port, RUN)
        self._tasks: list[asyncio.Task[None]] = []

    async def start(self) -> None:
        """Starts all members and waits until the learner receives trajectories from every actor."""
        run_dir: list[Word] = ["--run-dir", self.run_dir]
        self.router = await self._add("router", "router", ["--listen", f"tcp/127.0.0.1:{self._port}"])
        self.learner = await self._add("learner", "learner", [*run_dir, "--auto-resume", "--steps", str(ENDLESS)])
        self.evaluator = await self._add("evaluator", "evaluator", run_dir)
        self.actors = [await self._add(f"actor-{n}", "actor", ["--id", f"actor-{n}"]) for n in range(1, N_ACTORS + 1)]
        self.router.start()
        self.resume_learner()
        for member in (self.evaluator, *self.actors):
            member.start()
        supervisor = supervise(self.members, self.accidents, self._restart)
        self._tasks = [asyncio.create_task(self._watch()), asyncio.create_task(supervisor)]
        await eventually("the router listens", BACK_S, lambda: listens(self._port))
        await asyncio.to_thread(self.reports.open)
        await eventually("all actors have something acknowledged", 2 * BACK_S, lambda: all(map(self.acked, self.actors)))
        await eventually("a first checkpoint", BACK_S, lambda: records.checkpoints(self.run_dir))

    async def restart_learner(self, killed: bool) -> None:
        """Restarts the learner immediately and records the state on disk in between."""
        self.learner_lives[-1].killed = killed
        try:
            await (self.learner.kill() if killed else self.learner.terminate())
        finally:
            self._end_learner_life()
            self.resume_learner()

    async def stop_learner(self) -> None:
        """Stops the learner with SIGTERM. `resume_learner` starts it again."""
        await self.learner.terminate()
        self._end_learner_life()

    def resume_learner(self) -> None:
        """Starts the learner, for the first time or again."""
        self.learner_lives.append(records.Life(*records.newest_checkpoint(self.run_dir)))
        self.learner.start()

    def learner_has_taken(self) -> bool:
        """Returns whether the newest learner process has reported an accepted trajectory."""
        return self.learner_lives[-1].ingest.get("accepted_total", 0) > 0

    def n_updates(self) -> int:
        return sum(len(life.updates) for life in self.learner_lives)

    def report(self, actor: Member) -> ActorLife | None:
        """Returns the reports of an actor's newest process, or None if it has not reported yet."""
        life = self.reports.newest(actor.name)
        # The process reads its epoch from the clock shortly after its start.
        return life if life and life.epoch_ms >= int(actor.process.began * 1000) else None

    def acked(self, actor: Member) -> int:
        """Returns the number of trajectories from an actor's newest process that the learner acknowledged."""
        life = self.report(actor)
        return life.n_acked if life else 0

    async def stop(self) -> None:
        """Stops all members with SIGTERM, actors first and the router last."""
        for member in (*self.actors, self.evaluator):
            await member.terminate()
        await self.stop_learner()
        # The actors' last reports have arrived before the router stops.
        self.reports.digest()
        self.reports.close()
        await self.router.terminate()

    async def close(self) -> None:
        """Kills remaining processes and closes all connections."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for member in self.members:
            for process in member.processes[-1:]:
                process.kill()
            if member.relay is not None:
                await member.relay.close()
        await asyncio.to_thread(self.reports.close)

    async def _add(self, name: str, role: str, arguments: list[Word]) -> Member:
        relay = None
        command: list[Word] = [self._binary, role, *arguments]
        if role != "router":
            relay = Relay(self._port)
            await relay.listen()
            command += ["--connect", f"tcp/127.0.0.1:{relay.port}", "--preset", "smoke", "--run", RUN]
            command += ["--seed", str(self._seed), *settings(SETTINGS)]
        member = Member(name, role, command, self._logs, relay)
        self.members.append(member)
        return member

    async def _watch(self) -> None:
        next_sample = 0.0
        while True:
            self.reports.digest()
            self.learner_lives[-1].updates += self.lines.read()
            if time.monotonic() >= next_sample:
                next_sample = time.monotonic() + 1
                for member in self.members:
                    self.memory.sample(member)
            await asyncio.sleep(0.05)

    def _restart(self, member: Member) -> None:
        if member is self.learner:
            self.learner_lives[-1].killed = True
            self._end_learner_life()
            self.resume_learner()
        else:
            member.start()

    def _end_learner_life(self) -> None:
        life = self.learner_lives[-1]
        life.updates += self.lines.read()
        life.saved_steps_after, life.saved_accepted_after = records.newest_checkpoint(self.run_dir)

"""The members of the ring: each a succession of processes, under a supervisor that knows which exits were intended."""

import asyncio
import signal
from collections.abc import Callable, Sequence
from pathlib import Path

from ..ring.checks import Failed, eventually, require
from ..ring.processes import Process, Word
from .relay import Relay

# Longer than any role needs to drain and save, even on a busy machine.
GRACE_S = 60.0

# Small updates and a checkpoint after every second one, so that kills hit many of them.
SMALL_UPDATES: dict[str, object] = {
    "learner.batch_size": 256,
    "learner.minibatch_size": 128,
    "learner.mailbox.capacity_steps": 256,
    "learner.checkpoints.every_updates": 2,
}


class Member:
    """One member of the ring and its successive processes, each with its own log."""

    def __init__(self, name: str, role: str, command: Sequence[Word], logs: Path, relay: Relay | None = None) -> None:
        self.name = name
        self.role = role
        self.relay = relay
        self.processes: list[Process] = []
        # Active faults. The member is whole while this is empty.
        self.hurt: set[str] = set()
        self._command = command
        self._logs = logs
        self._is_to_end = False

    @property
    def process(self) -> Process:
        return self.processes[-1]

    def start(self) -> None:
        self._is_to_end = False
        log = self._logs / f"{self.name}-{len(self.processes) + 1:04}.log"
        self.processes.append(Process(self._command, log))

    def has_ended(self) -> bool:
        return self.process.code is not None

    async def kill(self) -> None:
        self._is_to_end = True
        self.process.send(signal.SIGKILL)
        await eventually(f"{self.name} is gone after kill -9", 10, self.has_ended, 0.005)

    async def terminate(self) -> None:
        """Sends SIGTERM and waits until the process exits, which must be with code 0."""
        self._is_to_end = True
        self.process.send(signal.SIGTERM)
        try:
            await eventually(f"{self.name} ends after SIGTERM", GRACE_S, self.has_ended, 0.01)
        except Failed:
            self.process.kill()
            raise
        code = self.process.code
        require(code == 0, f"{self.name} ended with {code} after SIGTERM, see {self.process.log}")

    def accident(self) -> str | None:
        """Returns what happened if the newest process has exited on its own."""
        if self._is_to_end or not self.processes or not self.has_ended():
            return None
        process = f"{self.name} (process {len(self.processes)})"
        return f"{process} ended by itself with {self.process.code}: {self.process.said()}"


async def supervise(members: list[Member], accidents: list[str], restart: Callable[[Member], None]) -> None:
    """Restarts members that exit on their own and records them in `accidents`."""
    while True:
        for member in members:
            if accident := member.accident():
                accidents.append(accident)
                print(f"FAILED  {accident}", flush=True)
                restart(member)
        await asyncio.sleep(0.1)

"""The processes of the ring, each with a log of its own, under a supervisor that knows which ends were meant."""

from __future__ import annotations

import asyncio
import contextlib
import enum
import os
import signal
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from checks import Failed, require, until
from relay import Relay

# Longer than any role needs to drain and save, on a machine that does other things as well.
GRACE_S = 60.0


class End(enum.Enum):
    """How a process came to its end."""

    KILLED = "killed"
    TERMINATED = "terminated"


@dataclass
class Life:
    """One process of a member."""

    number: int
    pid: int
    log: Path
    began: float
    """By the clock since 1970, seconds."""
    ended: float | None = None
    end: End | None = None
    code: int | None = None


class Member:
    """One role of the ring and its processes, one after the other."""

    def __init__(self, name: str, role: str, command: list[str], logs: Path, relay: Relay | None) -> None:
        self.name = name
        self.role = role
        self.relay = relay
        self.lives: list[Life] = []
        # Its faults of the moment; it is healthy while there are none.
        self.hurt: set[str] = set()
        self._command = command
        self._logs = logs
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def life(self) -> Life:
        """The newest process."""
        return self.lives[-1]

    @property
    def is_whole(self) -> bool:
        """Whether it has no fault now."""
        return not self.hurt

    def start(self) -> None:
        """Starts the next process."""
        number = len(self.lives) + 1
        log = self._logs / f"{self.name}-{number:04}.log"
        environment = {name: value for name, value in os.environ.items() if not name.startswith("LODESTONE_")}
        # The system kills it when this script ends, however that happens; the pid stays the program's.
        command = ["setpriv", "--pdeathsig", "KILL", *self._command]
        with log.open("wb") as output:
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, env=environment
            )
        self.lives.append(Life(number, self._process.pid, log, time.time()))

    def poll(self) -> int | None:
        """The exit code, if the newest process has ended."""
        return self._process.poll() if self._process else 0

    def send(self, number: signal.Signals) -> None:
        """Sends a signal to the newest process, if it has not ended."""
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(number)

    async def kill(self) -> None:
        """kill -9, and waits until it is gone."""
        self.life.end = End.KILLED
        self.send(signal.SIGKILL)
        await until(f"{self.name} is gone after kill -9", 10, lambda: self.poll() is not None, 0.005)
        self._note_end()

    async def terminate(self) -> None:
        """SIGTERM, and waits until it has ended, which must be well."""
        self.life.end = End.TERMINATED
        self.send(signal.SIGTERM)
        try:
            await until(f"{self.name} ends after SIGTERM", GRACE_S, lambda: self.poll() is not None, 0.01)
        except Failed:
            self.send(signal.SIGKILL)
            raise
        finally:
            self._note_end()
        require(self.life.code == 0, f"{self.name} ended with {self.life.code} after SIGTERM, see {self.life.log}")

    def ended_by_itself(self) -> bool:
        """Whether the newest process has ended though nobody asked it to."""
        if self.life.end is not None or self.poll() is None:
            return False
        self._note_end()
        return True

    def resident_kb(self) -> int | None:
        """VmRSS of the newest process."""
        with contextlib.suppress(OSError):
            for line in Path(f"/proc/{self.life.pid}/status").read_text().splitlines():
                if line.startswith("VmRSS:"):
                    return int(line.split()[1])
        return None

    def end_now(self) -> None:
        """Ends what still runs, without waiting for it to agree."""
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
            self._process.wait()

    def _note_end(self) -> None:
        self.life.ended = time.time()
        self.life.code = self.poll()


@dataclass
class Accident:
    """A process that ended by itself."""

    life: Life
    name: str

    def __str__(self) -> str:
        lines = self.life.log.read_text(errors="replace").splitlines()
        last = lines[-1] if lines else "nothing in its log"
        return f"{self.name} (process {self.life.number}) ended by itself with {self.life.code}: {last}"


def has_panicked(log: Path) -> str | None:
    """The line of a log that tells of a panic."""
    for line in log.read_text(errors="replace").splitlines():
        if "panicked" in line:
            return line
    return None


async def supervise(members: list[Member], accidents: list[Accident], restart: Callable[[Member], None]) -> None:
    """Restarts whatever ends by itself and keeps account."""
    while True:
        for member in members:
            if member.lives and member.ended_by_itself():
                accidents.append(Accident(member.life, member.name))
                print(f"FAILED  {accidents[-1]}", flush=True)
                restart(member)
        await asyncio.sleep(0.1)

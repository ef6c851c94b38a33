"""The processes of the ring, each with its own log, under a supervisor that knows which exits were intended."""

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

# Longer than any role needs to drain and save, even on a busy machine.
GRACE_S = 60.0


class End(enum.Enum):
    """How a process was ended."""

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
    """One member of the ring and its successive processes."""

    def __init__(self, name: str, role: str, command: list[str], logs: Path, relay: Relay | None) -> None:
        self.name = name
        self.role = role
        self.relay = relay
        self.lives: list[Life] = []
        # Active faults. The member is healthy while this is empty.
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
        """Whether the member has no active fault."""
        return not self.hurt

    def start(self) -> None:
        """Starts the next process."""
        number = len(self.lives) + 1
        log = self._logs / f"{self.name}-{number:04}.log"
        environment = {name: value for name, value in os.environ.items() if not name.startswith("LODESTONE_")}
        # The kernel kills the process when this script exits for any reason. `setpriv` execs, so the pid is the
        # program's.
        command = ["setpriv", "--pdeathsig", "KILL", *self._command]
        with log.open("wb") as output:
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, env=environment
            )
        self.lives.append(Life(number, self._process.pid, log, time.time()))

    def poll(self) -> int | None:
        """Returns the exit code if the newest process has ended, 0 if none was started."""
        return self._process.poll() if self._process else 0

    def send(self, number: signal.Signals) -> None:
        """Sends a signal to the newest process unless it has ended."""
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(number)

    async def kill(self) -> None:
        """Sends SIGKILL and waits until the process is gone."""
        self.life.end = End.KILLED
        self.send(signal.SIGKILL)
        await until(f"{self.name} is gone after kill -9", 10, lambda: self.poll() is not None, 0.005)
        self._note_end()

    async def terminate(self) -> None:
        """Sends SIGTERM and waits until the process exits, which must be with code 0."""
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
        """Returns whether the newest process has exited on its own."""
        if self.life.end is not None or self.poll() is None:
            return False
        self._note_end()
        return True

    def resident_kb(self) -> int | None:
        """Returns the VmRSS of the newest process, or None if it is gone."""
        with contextlib.suppress(OSError):
            for line in Path(f"/proc/{self.life.pid}/status").read_text().splitlines():
                if line.startswith("VmRSS:"):
                    return int(line.split()[1])
        return None

    def end_now(self) -> None:
        """Kills the process if it is still running."""
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
            self._process.wait()

    def _note_end(self) -> None:
        self.life.ended = time.time()
        self.life.code = self.poll()


@dataclass
class Accident:
    """A process that exited on its own."""

    life: Life
    name: str

    def __str__(self) -> str:
        lines = self.life.log.read_text(errors="replace").splitlines()
        last = lines[-1] if lines else "nothing in its log"
        return f"{self.name} (process {self.life.number}) ended by itself with {self.life.code}: {last}"


def has_panicked(log: Path) -> str | None:
    """Returns the line of a log that reports a panic, or None."""
    for line in log.read_text(errors="replace").splitlines():
        if "panicked" in line:
            return line
    return None


async def supervise(members: list[Member], accidents: list[Accident], restart: Callable[[Member], None]) -> None:
    """Restarts members that exit on their own and records them in `accidents`."""
    while True:
        for member in members:
            if member.lives and member.ended_by_itself():
                accidents.append(Accident(member.life, member.name))
                print(f"FAILED  {accidents[-1]}", flush=True)
                restart(member)
        await asyncio.sleep(0.1)

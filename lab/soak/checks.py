"""Helpers for checks: conditions with deadlines, and a tally with a one-line summary."""

from __future__ import annotations

import asyncio
import time
import traceback
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

PERIOD_S = 0.05


class Failed(Exception):
    """A failed check. The message reports what was observed."""


def require(holds: object, message: str) -> None:
    """Raises `Failed` with `message` unless `holds`."""
    if not holds:
        raise Failed(message)


async def until(what: str, seconds: float, condition: Callable[[], T], period_s: float = PERIOD_S) -> T:
    """Returns the first true value of `condition`. Raises `Failed` after `seconds`."""
    deadline = time.monotonic() + seconds
    while True:
        value = condition()
        if value:
            return value
        if time.monotonic() > deadline:
            raise Failed(f"not within {seconds:.0f} s: {what}")
        await asyncio.sleep(period_s)


class Tally:
    """Runs and counts checks and prints one line for each."""

    def __init__(self) -> None:
        self.n_passed = 0
        self.n_failed = 0
        self.said: dict[str, str] = {}

    def check(self, name: str, action: Callable[[], object]) -> None:
        """Runs `action` and prints its result after the name. The check fails if `action` raises."""
        try:
            self.passed(name, action())
        except Exception as error:
            self.failed(name, error)

    def passed(self, name: str, said: object = None) -> None:
        """Counts a check that passed."""
        self.n_passed += 1
        self.said[name] = str(said or "ok")
        print(f"ok      {name}{f': {said}' if said else ''}", flush=True)

    def failed(self, name: str, error: Exception) -> None:
        """Counts a check that failed."""
        self.n_failed += 1
        self.said[name] = f"FAILED: {error}"
        print(f"FAILED  {name}: {error}", flush=True)
        if not isinstance(error, Failed):
            traceback.print_exception(error)

    def closing_line(self) -> str:
        """Returns the last line of the script's output."""
        return f"{self.n_passed} passed, {self.n_failed} failed"

"""Conditions with deadlines, and a tally that reports one line for each check."""

import asyncio
import time
import traceback
from collections.abc import Awaitable, Callable, Iterable
from typing import TypeVar

T = TypeVar("T")

# How often a condition is looked at, and how often a wait says what it waits for, in seconds.
PERIOD_S = 0.2
PROGRESS_S = 30.0


class Patience:
    """Factor on all deadlines, for a machine that has other work."""

    factor = 1.0


class Failed(Exception):
    """A failed check. The message reports what was observed."""


def require(holds: object, message: str) -> None:
    """Raises `Failed` with `message` unless `holds`."""
    if not holds:
        raise Failed(message)


def require_none(complaints: Iterable[str]) -> None:
    """Raises `Failed` with all complaints, if there are any."""
    found = list(complaints)
    require(not found, "".join(f"\n        {complaint}" for complaint in found))


class Deadline:
    """The end of a wait. It says every half minute what is missing."""

    def __init__(self, what: str, seconds: float) -> None:
        self._what = what
        self._limit_s = seconds * Patience.factor
        self._began = self._told = time.monotonic()

    def check(self, seen: object) -> None:
        """Raises `Failed` when the time is up."""
        now = time.monotonic()
        waited_s = now - self._began
        if waited_s > self._limit_s:
            raise Failed(f"not within {self._limit_s:.0f} s: {self._what}; last seen: {seen}")
        if now - self._told > PROGRESS_S:
            self._told = now
            print(f"        waited {waited_s:.0f} of {self._limit_s:.0f} s: {self._what}; last seen: {seen}", flush=True)


def until(
    what: str,
    seconds: float,
    condition: Callable[[], T],
    well: Callable[[], object] = lambda: None,
    forgive: tuple[type[Exception], ...] = (),
) -> T:
    """Returns the first true value of `condition`. Fails after `seconds` times `Patience.factor`, or if `well` raises.

    An exception that is to be forgiven counts as "not yet": requests may be refused while processes start and stop.
    """
    deadline = Deadline(what, seconds)
    while True:
        try:
            value = condition()
            if value:
                return value
            seen = repr(value)
        except forgive as error:
            seen = f"{type(error).__name__}: {error}"
        well()
        deadline.check(seen)
        time.sleep(PERIOD_S)


async def eventually(what: str, seconds: float, condition: Callable[[], T], period_s: float = 0.05) -> T:
    """Like `until`, while other tasks go on."""
    deadline = Deadline(what, seconds)
    while True:
        value = condition()
        if value:
            return value
        deadline.check(repr(value))
        await asyncio.sleep(period_s)


class Tally:
    """Runs and counts checks. After `enough` failures the others are not tried: each would only time out."""

    def __init__(self, on_failure: Callable[[], object] = lambda: None, enough: int = 1_000) -> None:
        self.n_passed = 0
        self.n_failed = 0
        self.on_failure = on_failure
        self.said: dict[str, str] = {}
        self._enough = enough

    def check(self, name: str, action: Callable[[], object], always: bool = False) -> bool:
        """Runs `action` and prints its result after the name. The check fails if `action` raises."""
        if self.n_failed >= self._enough and not always:
            return self._fail(name, Failed("not tried, too much has failed"))
        began = time.monotonic()
        try:
            return self._pass(name, action(), began)
        except Exception as error:
            return self._fail(name, error)

    async def attempt(self, name: str, action: Awaitable[object]) -> bool:
        """Like `check`, for what is awaited."""
        began = time.monotonic()
        try:
            return self._pass(name, await action, began)
        except Exception as error:
            return self._fail(name, error)

    def close(self) -> int:
        """Prints the last line of the output and returns the exit code."""
        print(f"{self.n_passed} passed, {self.n_failed} failed", flush=True)
        return 1 if self.n_failed else 0

    def _pass(self, name: str, said: object, began: float) -> bool:
        self.n_passed += 1
        self.said[name] = str(said or "ok")
        print(f"ok      {name}{f': {said}' if said else ''} ({time.monotonic() - began:.1f} s)", flush=True)
        return True

    def _fail(self, name: str, error: Exception) -> bool:
        self.n_failed += 1
        self.said[name] = f"FAILED: {error}"
        print(f"FAILED  {name}: {error}", flush=True)
        if not isinstance(error, Failed):
            traceback.print_exception(error)
        if self.n_failed <= self._enough:
            self.on_failure()
        return False

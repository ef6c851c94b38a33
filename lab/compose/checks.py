"""Helpers for check scripts: conditions with deadlines, and a tally with a one-line summary."""

import time
import traceback
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

# Polling interval for conditions. Docker itself checks health every few seconds.
PERIOD_S = 0.5


class Patience:
    """Scale factor for all timeouts, relative to two idle cores."""

    factor = 1.0


class Failed(Exception):
    """A failed check. The message reports what was observed."""


def require(holds: object, message: str) -> None:
    """Raises `Failed` with `message` unless `holds`."""
    if not holds:
        raise Failed(message)


def until(what: str, seconds: float, condition: Callable[[], T]) -> T:
    """Returns the first true value of `condition`. Raises `Failed` after `seconds`, scaled by `Patience.factor`.

    An exception counts as "not yet", because requests may be refused while processes start and stop.
    """
    seconds *= Patience.factor
    deadline = time.monotonic() + seconds
    while True:
        seen = "nothing"
        try:
            value = condition()
            if value:
                return value
            seen = repr(value)
        except Exception as error:
            seen = f"{type(error).__name__}: {error}"
        if time.monotonic() > deadline:
            raise Failed(f"not within {seconds:.0f} s: {what}; last seen: {seen}")
        time.sleep(PERIOD_S)


# After this many failures, the remaining checks are skipped: each would only time out.
ENOUGH_FAILURES = 3


class Tally:
    """Runs and counts checks and prints one line for each."""

    def __init__(self, on_failure: Callable[[], None] = lambda: None) -> None:
        self.n_passed = 0
        self.n_failed = 0
        self.on_failure = on_failure

    def check(self, name: str, action: Callable[[], object], always: bool = False) -> bool:
        """Runs `action` and prints its result after the name. The check fails if `action` raises.

        After too many failures, the check is skipped and counts as failed unless `always` is set.
        """
        if self.n_failed >= ENOUGH_FAILURES and not always:
            self.n_failed += 1
            print(f"not run {name}: too much has failed", flush=True)
            return False
        began = time.monotonic()
        try:
            said = action()
        except Exception as error:
            self.n_failed += 1
            print(f"FAILED  {name}: {error}", flush=True)
            if not isinstance(error, Failed):
                traceback.print_exc()
            self.on_failure()
            return False
        self.n_passed += 1
        shown = f": {said}" if said else ""
        print(f"ok      {name}{shown} ({time.monotonic() - began:.1f} s)", flush=True)
        return True

    def closing_line(self) -> str:
        """Returns the last line of the script's output."""
        return f"{self.n_passed} passed, {self.n_failed} failed"

"""What a script of checks needs: conditions with deadlines, and a tally that ends in one line."""

import time
import traceback
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

# Between two looks at a condition. Docker itself looks at health every few seconds.
PERIOD_S = 0.5


class Patience:
    """How much longer than on two idle cores everything may take."""

    factor = 1.0


class Failed(Exception):
    """Something that must hold does not; the text says what was seen."""


def require(holds: object, message: str) -> None:
    """Fails with `message` unless `holds`."""
    if not holds:
        raise Failed(message)


def until(what: str, seconds: float, condition: Callable[[], T]) -> T:
    """The first true value of `condition`; fails if there is none for so long.

    An exception counts as `not yet`: while processes come and go, whoever asks them is refused now and then.
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


# After so many failures the others are not tried: each would wait for what does not come.
ENOUGH_FAILURES = 3


class Tally:
    """Counts checks and prints one line for each."""

    def __init__(self, on_failure: Callable[[], None] = lambda: None) -> None:
        self.n_passed = 0
        self.n_failed = 0
        self.on_failure = on_failure

    def check(self, name: str, action: Callable[[], object], always: bool = False) -> bool:
        """Runs `action`; what it returns is printed behind the name, what it raises makes the check fail.

        After too many failures it is not run and counts as failed, unless it is to be run `always`.
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
        """The last line of the script."""
        return f"{self.n_passed} passed, {self.n_failed} failed"

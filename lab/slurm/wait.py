"""Waits for conditions instead of fixed times."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")

INTERVAL_S = 0.2

PATIENCE = float(os.environ.get("PATIENCE", "1"))
"""Factor on all limits, for a machine that has other work; `run.py --patience` sets it."""


class LateError(AssertionError):
    """A condition that did not become true in time."""


def wait_for(what: str, condition: Callable[[], T], limit_s: float, still_well: Callable[[], None] | None = None) -> T:
    """Returns the first true value of `condition`. Fails after `limit_s` times `PATIENCE` or if `still_well` raises."""
    limit_s *= PATIENCE
    deadline = time.monotonic() + limit_s
    while True:
        value = condition()
        if value:
            return value
        if still_well is not None:
            still_well()
        if time.monotonic() > deadline:
            raise LateError(f"not within {limit_s:.0f} s: {what}; last seen: {value!r}")
        time.sleep(INTERVAL_S)


class Watch:
    """Measures the duration of a block."""

    seconds: float = 0.0

    def __enter__(self) -> Watch:
        self._began = time.monotonic()
        return self

    def __exit__(self, *_: object) -> None:
        self.seconds = time.monotonic() - self._began


def timed(what: str, condition: Callable[[], object], limit_s: float, still_well: Callable[[], None] | None = None) -> float:
    """Returns the seconds until `condition` was true."""
    with Watch() as watch:
        wait_for(what, condition, limit_s, still_well)
    return watch.seconds


def in_background(what: str, condition: Callable[[], object], limit_s: float) -> Future[float]:
    """Like `timed`, but in the background."""
    return ThreadPoolExecutor(max_workers=1).submit(timed, what, condition, limit_s)

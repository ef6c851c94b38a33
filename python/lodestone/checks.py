"""Checks of arguments. Every refusal is a ValueError that gives the argument, its value, and what is allowed."""

from __future__ import annotations

import math
import operator
import reprlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

_short = reprlib.Repr()
_short.maxstring = _short.maxother = 120


def refusal(name: str, value: Any, expected: str) -> ValueError:
    """Returns the error for an argument. Long values are cut, and of arrays only the kind is shown."""
    if isinstance(value, np.ndarray):
        shown = f"an array of {value.dtype} with shape {value.shape}"
    else:
        shown = _short.repr(value)
    return ValueError(f"{name} is {shown}: expected {expected}")


def text(name: str, value: Any, expected: str) -> str:
    """Returns a text, which must have a form in UTF-8."""
    if isinstance(value, str):
        try:
            value.encode()
        except UnicodeEncodeError:
            raise refusal(name, value, "a text in Unicode") from None
        return str(value)
    raise refusal(name, value, expected)


def one_of(name: str, value: Any, options: Iterable[str | None], note: str = "") -> None:
    """Refuses what is not among the options."""
    options = list(options)
    # A comparison with an array would have no single answer.
    if not (value is None or isinstance(value, str)) or value not in options:
        shown = [str(option) for option in options]
        expected = f"{', '.join(shown[:-1])} or {shown[-1]}" if len(shown) > 1 else shown[0]
        raise refusal(name, value, expected + note)


def flag(name: str, value: Any) -> bool:
    """Returns a truth value."""
    if not isinstance(value, (bool, np.bool_)):
        raise refusal(name, value, "True or False")
    return bool(value)


def whole(name: str, value: Any, low: int, high: int | None = None, note: str = "") -> int:
    """Returns a whole number of any type, from `low` to `high`."""
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.item()
    try:
        # `True` would be 1.
        number = None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        number = None
    if number is None or number < low or (high is not None and number > high):
        to = "" if high is None else f" to {high}"
        raise refusal(name, value, f"a whole number from {low}{to}{note}")
    return number


def seed_of(name: str, value: Any) -> int | None:
    """Returns a seed, or None."""
    return None if value is None else whole(name, value, 0, note=", or None")


def size_of(name: str, value: Any) -> tuple[int, int]:
    """Returns the width and height of an image."""
    try:
        width, height = (whole(name, side, 32, 4096) for side in value)
    except (TypeError, ValueError):
        raise refusal(name, value, "width and height in pixels, 32 to 4096 each") from None
    return width, height


def mapping(name: str, value: Any, expected: str = "a dictionary") -> Mapping[str, Any]:
    """Returns a dictionary whose keys are texts; for None, an empty one."""
    value = {} if value is None else value
    if not isinstance(value, Mapping):
        raise refusal(name, value, expected)
    for key in value:
        text(f"a key of {name}", key, "a text")
    return value


def array(name: str, values: Any, expected: str = "numbers") -> NDArray[Any]:
    """Returns an array of numbers or truth values."""
    try:
        made = np.asarray(values)
    except (TypeError, ValueError):
        made = None
    if made is None or made.dtype.kind not in "biuf":
        raise refusal(name, values, expected)
    return made


def numbers(name: str, values: Any, shape: Sequence[int]) -> NDArray[np.float32]:
    """Returns an array of this shape in the layout for the native module."""
    made = array(name, values, f"numbers of shape {tuple(shape)}")
    if made.shape != tuple(shape):
        raise ValueError(f"{name} has shape {made.shape}: expected {tuple(shape)}")
    return np.ascontiguousarray(made, np.float32)


def blocks(name: str, values: Any, shape: Sequence[int]) -> NDArray[np.int64]:
    """Returns an array of this shape of whole numbers in the layout for the native module, which checks their range."""
    made = array(name, values, f"whole numbers of shape {tuple(shape)}")
    if not np.issubdtype(made.dtype, np.integer):
        raise ValueError(f"{name} has the type {made.dtype}: expected whole numbers")
    if made.shape != tuple(shape):
        raise ValueError(f"{name} has shape {made.shape}: expected {tuple(shape)}")
    return np.ascontiguousarray(made, np.int64)


def picks(name: str, values: Any, shape: Sequence[int], n: int) -> NDArray[np.int64]:
    """Returns an array of this shape of whole numbers from 0 to n - 1."""
    made = blocks(name, values, shape)
    wrong = (made < 0) | (made >= n)
    if wrong.any():
        raise refusal(f"{name}: a pick", int(made[wrong][0]), f"a whole number from 0 to {n - 1}")
    return made


def plain(name: str, value: Any) -> Any:
    """Returns settings as values that JSON has."""
    try:
        return _plain(name, value)
    except RecursionError:
        raise refusal(name, value, "no dictionary or list within itself") from None


def _plain(name: str, value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(f"{name}.{key}", entry) for key, entry in mapping(name, value).items()}
    if isinstance(value, (list, tuple)):
        return [_plain(f"{name}[{at}]", entry) for at, entry in enumerate(value)]
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, int) and abs(value) < 2**64:
        return value
    if isinstance(value, float) and math.isfinite(value):
        return value
    expected = "a finite number, a text, True, False, None, a list, or a dictionary"
    return text(name, value, expected)

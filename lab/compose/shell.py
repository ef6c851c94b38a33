"""Runs external programs."""

import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from checks import Failed


def run(
    command: Sequence[str | Path],
    env: Mapping[str, str] | None = None,
    seconds: float = 300,
    stdin: bytes | None = None,
) -> str:
    """Returns what `command` prints to stdout. If it fails, raises `Failed` with the end of its output."""
    shown = " ".join(str(part) for part in command)
    try:
        ended = subprocess.run(command, env=env, input=stdin, capture_output=True, timeout=seconds, check=False)
    except subprocess.TimeoutExpired:
        raise Failed(f"`{shown}` was not done within {seconds:.0f} s") from None
    if ended.returncode != 0:
        said = (ended.stdout + ended.stderr).decode(errors="replace").strip().splitlines()
        raise Failed(f"`{shown}` ended with {ended.returncode}: " + "\n".join(said[-15:]))
    return ended.stdout.decode(errors="replace")


def works(command: Sequence[str | Path]) -> bool:
    """Returns whether `command` exists and succeeds."""
    try:
        return subprocess.run(command, capture_output=True, timeout=60, check=False).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False

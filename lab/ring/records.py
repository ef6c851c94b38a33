"""Reads what a run leaves in its folder: metrics.jsonl by learner process, checkpoints, the history of evaluations."""

import json
import sqlite3
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .checks import require

Update = dict[str, Any]


@dataclass
class Life:
    """One learner process: its lines in metrics.jsonl, and for whoever started it the checkpoints around it."""

    saved_steps_before: int = 0
    """Steps of the newest checkpoint when it was started."""
    saved_accepted_before: int = 0
    """Trajectories accepted, as that checkpoint counts them over all processes."""
    updates: list[Update] = field(default_factory=list)
    killed: bool = False
    saved_steps_after: int = 0
    saved_accepted_after: int = 0

    @property
    def began_with(self) -> int:
        """Environment steps that the process resumed from, by its first line."""
        first = self.updates[0]
        return int(first["n_env_steps"]) - int(first["n_update_steps"])

    @property
    def ended_with(self) -> int:
        """Environment steps after the last update."""
        return int(self.updates[-1]["n_env_steps"]) if self.updates else self.saved_steps_before

    @property
    def ingest(self) -> dict[str, int]:
        """Ingest counts in the last line."""
        return dict(self.updates[-1]["ingest"]) if self.updates else {}

    @property
    def n_taken(self) -> int:
        """Trajectories acknowledged as of the last line: accepted ones and repeats of them."""
        return self.ingest.get("accepted_total", 0) + self.ingest.get("duplicates_total", 0)


class Lines:
    """Reads metrics.jsonl as it grows. A learner that resumes removes the lines after its checkpoint."""

    def __init__(self, run: Path) -> None:
        self._path = run / "metrics.jsonl"
        self._known: set[bytes] = set()
        self._rest = b""
        self.broken: list[str] = []

    def read(self) -> list[Update]:
        """Returns the learner's lines since the last call."""
        if not self._path.exists():
            return []
        *lines, self._rest = self._path.read_bytes().split(b"\n")
        new = [line for line in lines if line not in self._known]
        self._known.update(new)
        found = []
        for line in new:
            try:
                found.append(json.loads(line))
            except ValueError as error:
                self.broken.append(f"{error}: {line[:80]!r}")
        return [entry for entry in found if entry["key"] == "learner"]

    def all_whole(self) -> str:
        """Fails if a line is broken or the last line is incomplete."""
        require(not self.broken, "; ".join(self.broken[:3]))
        require(not self._rest, f"the last line has no end: {self._rest[:80]!r}")
        return f"{len(self._known)} lines"


def entries(run: Path, key: str = "learner") -> list[Update]:
    """Returns the lines of metrics.jsonl with this key. Fails if one is broken; the last may still be in writing."""
    path = run / "metrics.jsonl"
    *lines, _ = path.read_bytes().split(b"\n") if path.exists() else [b""]
    return [entry for entry in map(json.loads, lines) if entry["key"] == key]


def lives(run: Path) -> list[Life]:
    """Returns the learner's processes. `elapsed_s` counts from the start of a process, so it drops with the next."""
    found: list[Life] = []
    elapsed_s = float("inf")
    for update in entries(run):
        if update["elapsed_s"] < elapsed_s:
            found.append(Life())
        elapsed_s = update["elapsed_s"]
        found[-1].updates.append(update)
    require(found, "metrics.jsonl has no line of the learner")
    return found


def updates_add_up(lives: list[Life]) -> str:
    """Checks that no process counts a step twice or loses one, and that update numbers have no gap."""
    for number, life in enumerate(lives, 1):
        for before, after in zip(life.updates, life.updates[1:]):
            found, expected = after["n_env_steps"], before["n_env_steps"] + after["n_update_steps"]
            require(found == expected, f"process {number}: {found} steps after an update, not {expected}")
            numbers = before["n_updates"], after["n_updates"]
            require(numbers[1] == numbers[0] + 1, f"process {number}: update {numbers[1]} after {numbers[0]}")
    return f"{sum(len(life.updates) for life in lives)} updates in {len(lives)} processes"


def verdicts_add_up(lives: list[Life], least: int, most: int) -> str:
    """Checks that each trajectory that arrived has one verdict, but for `least` to `most` that wait for theirs."""
    n_received = most_waiting = 0
    for number, life in enumerate(lives, 1):
        for update in life.updates:
            ingest: dict[str, int] = update["ingest"]
            waiting = 2 * ingest["received_total"] - sum(ingest.values())
            require(least <= waiting <= most, f"process {number}: {waiting} wait in {ingest}")
            most_waiting = max(most_waiting, waiting)
        n_received += life.ingest.get("received_total", 0)
    return f"{n_received} arrived at {len(lives)} processes, at most {most_waiting} had no verdict yet"


def checkpoints(run: Path) -> dict[int, Path]:
    """Returns the checkpoints of a run by step, in order."""
    found = {int(path.name.removeprefix("step-")): path for path in (run / "checkpoints").glob("step-*")}
    return dict(sorted(found.items()))


def saved_steps(run: Path) -> int:
    """Returns the steps of the newest checkpoint, or 0 if there is none."""
    return max(checkpoints(run), default=0)


def newest_checkpoint(run: Path) -> tuple[int, int]:
    """Returns the steps and accepted trajectories of the newest checkpoint, or zeros if there is none."""
    saved = checkpoints(run)
    if not saved:
        return 0, 0
    steps, path = saved.popitem()
    state = json.loads((path / "state.json").read_text())["state"]
    return steps, int(state["mailbox"]["accepted_total"])


def unfinished(run: Path) -> list[str]:
    """Returns what else lies among the checkpoints: those whose writing was interrupted or is in progress."""
    folder = run / "checkpoints"
    names = [path.name for path in folder.iterdir()] if folder.is_dir() else []
    return [name for name in names if not name.startswith(("step-", "best"))]


def fnv1a(data: bytes) -> str:
    """Returns the 64-bit FNV-1a hash in the checkpoints' format."""
    value = 0xCBF29CE484222325
    for byte in data:
        value = ((value ^ byte) * 0x100000001B3) & 0xFFFFFFFFFFFFFFFF
    return f"{value:016x}"


def checkpoint_is_whole(path: Path) -> None:
    """Fails unless all files of a checkpoint match its state.json."""
    state = json.loads((path / "state.json").read_text())
    require(f"step-{state['state']['n_env_steps']}" == path.name, f"{path.name} has {state['state']['n_env_steps']} steps")
    for info in state["files"]:
        name, data = f"{path.name}/{info['name']}", (path / info["name"]).read_bytes()
        require(len(data) == info["n_bytes"], f"{name} has {len(data)} bytes instead of {info['n_bytes']}")
        require(fnv1a(data) == info["fnv1a"], f"{name} is not what was written")


def checkpoints_are_whole(run: Path) -> dict[int, Path]:
    """Returns the checkpoints of a run. Fails if there is none, or if one is damaged or unfinished."""
    saved = checkpoints(run)
    require(saved, "there is no checkpoint")
    for path in saved.values():
        checkpoint_is_whole(path)
    require(not unfinished(run), f"left over: {', '.join(unfinished(run))}")
    return saved


def database_is_whole(run: Path) -> str:
    """Checks the integrity of the evaluation history with SQLite and returns the row counts of its tables."""
    with sqlite3.connect(f"file:{run / 'eval.db'}?mode=ro", uri=True) as database:
        verdict = database.execute("pragma integrity_check").fetchone()[0]
        tables = [row[0] for row in database.execute("select name from sqlite_master where type = 'table' order by name")]
        rows = {table: database.execute(f'select count(*) from "{table}"').fetchone()[0] for table in tables}
    require(verdict == "ok", str(verdict))
    require(tables, "it has no tables")
    return ", ".join(f"{n} rows in {table}" for table, n in rows.items())

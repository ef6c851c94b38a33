"""Reads what the run left on disk: metrics.jsonl by learner process, checkpoints, and the evaluation history."""

from __future__ import annotations

import json
import sqlite3
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from checks import require

Update = dict[str, Any]


@dataclass
class LearnerLife:
    """One learner process: its lines in metrics.jsonl and the checkpoints before and after it."""

    saved_steps_before: int
    """Steps of the newest checkpoint when it was started."""
    saved_accepted_before: int
    """Trajectories accepted, as that checkpoint counts them over all processes."""
    updates: list[Update] = field(default_factory=list)
    killed: bool = False
    saved_steps_after: int = 0
    saved_accepted_after: int = 0

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

    def __init__(self, path: Path) -> None:
        self._path = path
        self._known: set[bytes] = set()
        self._rest = b""
        self.n_lines = 0
        self.broken: list[str] = []

    def read(self) -> list[Update]:
        """Returns the learner's lines since the last call."""
        try:
            *lines, self._rest = self._path.read_bytes().split(b"\n")
        except FileNotFoundError:
            return []
        new = [line for line in lines if line not in self._known]
        self._known.update(new)
        found = []
        for line in new:
            self.n_lines += 1
            try:
                entry = json.loads(line)
            except ValueError as error:
                self.broken.append(f"line {self.n_lines}: {error}: {line[:80]!r}")
                continue
            if entry["key"] == "learner":
                found.append(entry)
        return found

    def all_whole(self) -> str:
        """Fails if a line is broken or the last line is incomplete."""
        require(not self.broken, "; ".join(self.broken[:3]))
        require(not self._rest, f"the last line has no end: {self._rest[:80]!r}")
        return f"{self.n_lines} lines"


def began_with(life: LearnerLife) -> int:
    """Returns the steps that a process with at least one line resumed from."""
    return int(life.updates[0]["n_env_steps"]) - int(life.updates[0]["n_update_steps"])


def checkpoints(run: Path) -> dict[int, Path]:
    """Returns the checkpoints of a run by step, in order."""
    found = {int(path.name.removeprefix("step-")): path for path in (run / "checkpoints").glob("step-*")}
    return dict(sorted(found.items()))


def cut_short(run: Path) -> list[Path]:
    """Returns the folders of checkpoints whose writing was interrupted or is in progress."""
    folder = run / "checkpoints"
    return [path for path in folder.iterdir() if path.name.startswith(".")] if folder.is_dir() else []


def newest_checkpoint(run: Path) -> tuple[int, int]:
    """Returns the steps and accepted trajectories of the newest checkpoint, or zeros if there is none."""
    saved = checkpoints(run)
    if not saved:
        return 0, 0
    steps, path = saved.popitem()
    state = json.loads((path / "state.json").read_text())["state"]
    return steps, int(state["mailbox"]["accepted_total"])


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
        data = (path / info["name"]).read_bytes()
        n_expected = info["n_bytes"]
        require(len(data) == n_expected, f"{path.name}/{info['name']} has {len(data)} bytes instead of {n_expected}")
        require(fnv1a(data) == info["fnv1a"], f"{path.name}/{info['name']} is not what was written")


def steps_add_up(lives: list[LearnerLife]) -> str:
    """Checks that no process loses a step or counts one twice, and that each resumes from the newest checkpoint."""
    most_again = 0
    for number, life in enumerate(lives, 1):
        for before, after in zip(life.updates, life.updates[1:]):
            expected = before["n_env_steps"] + after["n_update_steps"]
            found = after["n_env_steps"]
            require(found == expected, f"process {number}: {found} steps after an update, not {expected}")
        if life.updates:
            found, expected = began_with(life), life.saved_steps_before
            require(found == expected, f"process {number} began with {found} steps, the checkpoint had {expected}")
    for life, successor in zip(lives, lives[1:]):
        require(successor.saved_steps_before >= life.saved_steps_before, "the newest checkpoint went back")
        trained = int(life.updates[-1]["n_env_steps"]) if life.updates else life.saved_steps_before
        again = trained - life.saved_steps_after
        require(again <= 0 or life.killed, f"{again} steps were lost though the learner ended by SIGTERM")
        most_again = max(most_again, again)
    n_updates = sum(len(life.updates) for life in lives)
    return f"{n_updates} updates in {len(lives)} processes, at most {most_again} steps trained again after a kill"


def database_is_whole(path: Path) -> str:
    """Checks the integrity of the evaluation history with SQLite and returns the row counts of its tables."""
    with sqlite3.connect(f"file:{path}?mode=ro", uri=True) as database:
        verdict = database.execute("pragma integrity_check").fetchone()[0]
        tables = [row[0] for row in database.execute("select name from sqlite_master where type = 'table' order by name")]
        rows = {table: database.execute(f'select count(*) from "{table}"').fetchone()[0] for table in tables}
    require(verdict == "ok", str(verdict))
    require(tables, "it has no tables")
    return ", ".join(f"{n} rows in {table}" for table, n in rows.items())

"""Checks that the figures a run left in its volume are consistent."""

import json
import sqlite3
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from checks import require

# Upper bound on an actor's trajectories in flight, and so on those received but without a verdict.
UNDER_WAY = 64

Update = dict[str, Any]


@dataclass(frozen=True)
class Life:
    """The updates of one learner process, in order."""

    updates: list[Update]

    @property
    def began_with(self) -> int:
        """Environment steps that the process resumed from."""
        first = self.updates[0]
        return int(first["n_env_steps"]) - int(first["n_update_steps"])

    @property
    def ended_with(self) -> int:
        """Environment steps after the last update."""
        return int(self.updates[-1]["n_env_steps"])


def lives(metrics: Path) -> list[Life]:
    """Returns the learner's processes according to metrics.jsonl. Fails if a line is broken."""
    found: list[Life] = []
    elapsed = float("inf")
    for number, line in enumerate(metrics.read_text().splitlines(keepends=True), 1):
        if not line.endswith("\n"):
            # This line is still being written. A truncated line would have others after it.
            break
        try:
            update = json.loads(line)
        except ValueError as error:
            raise AssertionError(f"line {number} of metrics.jsonl is broken: {error}") from None
        if update["key"] != "learner":
            continue
        # `elapsed_s` counts from the start of the process, so it drops when the next process starts.
        if update["elapsed_s"] < elapsed:
            found.append(Life([]))
        elapsed = update["elapsed_s"]
        found[-1].updates.append(update)
    require(found, "metrics.jsonl has no line of the learner")
    return found


def verdicts_add_up(all_lives: list[Life]) -> str:
    """Checks that every received trajectory has a verdict, in every update of every process."""
    n_received = 0
    for life in all_lives:
        for update in life.updates:
            ingest = update["ingest"]
            answered = sum(n for name, n in ingest.items() if name != "received_total")
            pending = ingest["received_total"] - answered
            require(0 <= pending <= UNDER_WAY, f"{pending} trajectories have no verdict in {ingest}")
        n_received += life.updates[-1]["ingest"]["received_total"]
    return f"{n_received} trajectories in {len(all_lives)} lives of the learner"


def steps_add_up(all_lives: list[Life]) -> str:
    """Checks that no process counts a step twice or loses one, and that update numbers have no gap."""
    n_updates = 0
    for life in all_lives:
        for before, after in zip(life.updates, life.updates[1:]):
            expected = before["n_env_steps"] + after["n_update_steps"]
            require(after["n_env_steps"] == expected, f"{after['n_env_steps']} steps, not {expected}")
            require(after["n_updates"] == before["n_updates"] + 1, f"update {after['n_updates']} after {before['n_updates']}")
        n_updates += len(life.updates)
    return f"{n_updates} updates"


def saved_steps(run: Path) -> list[int]:
    """Returns the steps of a run's checkpoints, in order."""
    return sorted(int(entry.name.removeprefix("step-")) for entry in (run / "checkpoints").glob("step-*"))


def nothing_is_left_over(run: Path) -> None:
    """Checks that the checkpoints folder holds no partial files."""
    strange = [entry.name for entry in (run / "checkpoints").iterdir() if not entry.name.startswith(("step-", "best"))]
    require(not strange, f"there are {strange}")


def database_is_whole(path: Path) -> str:
    """Checks the integrity of the evaluation history with SQLite and returns its tables."""
    with sqlite3.connect(path) as database:
        verdict = database.execute("pragma integrity_check").fetchone()[0]
        tables = [row[0] for row in database.execute("select name from sqlite_master where type = 'table' order by name")]
    require(verdict == "ok", verdict)
    require(tables, "it has no tables")
    return ", ".join(tables)

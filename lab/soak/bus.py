"""Collects the reports of actors on the bus, per process."""

from __future__ import annotations

import asyncio
import json
import socket
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import zenoh

from checks import until

Report = dict[str, Any]


@dataclass
class ActorLife:
    """The reports of one actor process."""

    actor: str
    epoch_ms: int
    last: Report
    last_at: float
    n_reports: int = 1
    most_acked_between: int = 0
    """The most that were acknowledged between two reports."""
    going_back: list[str] = field(default_factory=list)

    @property
    def n_acked(self) -> int:
        """Trajectories that the learner acknowledged, as of the last report."""
        return int(self.last["n_trajectories_acked"])

    @property
    def n_dropped(self) -> int:
        """Trajectories that were dropped, without diverged episodes, which are never sent."""
        dropped: dict[str, int] = self.last["dropped"]
        return sum(n for reason, n in dropped.items() if reason != "diverged_total")

    def take(self, report: Report, now: float) -> None:
        """Processes the next report."""
        if report["elapsed_s"] <= self.last["elapsed_s"]:
            # Subscription samples and query replies overlap after a reconnect.
            return
        for count in ("n_trajectories_acked", "n_env_steps", "n_episodes"):
            if report[count] < self.last[count]:
                self.going_back.append(f"{self.actor}: {count} fell from {self.last[count]} to {report[count]}")
        between = report["n_trajectories_acked"] - self.n_acked
        self.most_acked_between = max(self.most_acked_between, between)
        self.last, self.last_at, self.n_reports = report, now, self.n_reports + 1


class Listener:
    """A viewer that follows all actors and the evaluator across router restarts."""

    def __init__(self, port: int, run: str) -> None:
        self.actors: dict[tuple[str, int], ActorLife] = {}
        self.n_summaries = 0
        self.wrong: list[str] = []
        self._port = port
        self._prefix = f"lodestone/{run}/metrics/"
        self._config = zenoh.Config()
        self._config.insert_json5("mode", '"client"')
        self._config.insert_json5("connect/endpoints", json.dumps([f"tcp/127.0.0.1:{port}"]))
        self._config.insert_json5("connect/timeout_ms", "-1")
        self._config.insert_json5("connect/exit_on_failure", "false")
        retry = {"period_init_ms": 200, "period_max_ms": 500, "period_increase_factor": 2}
        self._config.insert_json5("connect/retry", json.dumps(retry))
        self._config.insert_json5("scouting/multicast/enabled", "false")
        self._samples: deque[tuple[float, str, bytes]] = deque()
        self._session: zenoh.Session | None = None
        self._lock = threading.Lock()

    async def open(self, seconds: float) -> None:
        """Connects and subscribes. Waits up to `seconds` for the router."""
        # zenoh would wait forever, in a thread that cannot be stopped.
        await until("the router listens", seconds, lambda: _listens(self._port), 0.1)
        await asyncio.to_thread(self._open)

    def newest(self, actor: str) -> ActorLife | None:
        """Returns the newest process of an actor that has reported, or None."""
        lives = [life for (name, _), life in self.actors.items() if name == actor]
        return max(lives, key=lambda life: life.epoch_ms, default=None)

    def digest(self) -> None:
        """Processes the samples received since the last call."""
        while self._samples:
            now, suffix, payload = self._samples.popleft()
            try:
                report = json.loads(payload)
            except ValueError as error:
                self.wrong.append(f"{suffix} is no JSON: {error}")
                continue
            if suffix == "eval/summary":
                self.n_summaries += bool(report["is_complete"])
            elif suffix.startswith("actor/"):
                self._take(report, now)

    def close(self) -> None:
        """Disconnects from the bus."""
        with self._lock:
            if self._session is not None:
                self._session.close()  # type: ignore[no-untyped-call]
                self._session = None

    def _take(self, report: Report, now: float) -> None:
        key = (str(report["actor"]), int(report["epoch"]))
        if key in self.actors:
            self.actors[key].take(report, now)
        else:
            self.actors[key] = ActorLife(*key, report, now, most_acked_between=int(report["n_trajectories_acked"]))

    def _open(self) -> None:
        session = zenoh.open(self._config)
        session.declare_subscriber(self._prefix + "**", self._push)
        with self._lock:
            self._session = session
        self._ask()

    def _ask(self) -> None:
        with self._lock:
            if self._session is None:
                return
            for reply in self._session.get(self._prefix + "actor/*", timeout=2):
                if reply.ok:
                    self._push(reply.ok)

    def _push(self, sample: zenoh.Sample) -> None:
        suffix = str(sample.key_expr).removeprefix(self._prefix)
        self._samples.append((time.time(), suffix, sample.payload.to_bytes()))


def _listens(port: int) -> bool:
    try:
        with socket.create_connection(("127.0.0.1", port), timeout=1):
            return True
    except OSError:
        return False

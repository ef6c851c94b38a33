#!/usr/bin/env python3
"""Floods a ring with the keys of an actor, and prints how much of its speed the ring keeps.

Usage: python lab/soak/flood.py --binary target/debug/lodestone [--seconds 20] [--json FILE]

Needs the Python package eclipse-zenoh (pip install -r deploy/examples/requirements.txt) and `setpriv` from util-linux.
A router with keys, a learner, and an actor train `near-goal` on loopback. One processor is the flooder's. The speed
under a flood is compared with the speed beside a busy loop on that processor, and the speed from 5 s after the flood
with the speed when nothing disturbs the ring. docs/soak.md has the figures.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any

from ring import ENDLESS, free_port

RUN = "near-goal"
ROLES = ("router", "learner", "actor")
READY_S = 120.0
# After the end of a flood, the time until the ring must have its speed back.
BACK_S = 5.0
# Share of the speed beside a busy loop, and of the undisturbed speed afterwards, that the ring should keep.
GOAL_UNDER, GOAL_AFTER = 0.8, 0.95

# What a flooder sends without waiting for answers: arguments of `Session.get` or `Session.put`, by number of the message.
FLOODS: dict[str, Callable[[int], tuple[str, dict[str, Any]]]] = {
    "pulls": lambda number: ("weights/latest", {}),
    "pulls under invented names": lambda number: ("weights/latest?session=flood-%d" % number, {}),
    "garbage": lambda number: (f"ingest/flood-{number % 7}", {"payload": b"garbage" + bytes(200)}),
    "metrics": lambda number: ("metrics/actor/flood", {"payload": b"garbage" + bytes(200)}),
}


def arguments() -> argparse.Namespace:
    """Parses the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--binary", type=Path, required=True, help="the program lodestone")
    parser.add_argument("--seconds", type=float, default=20.0, help="length of each measurement [default: 20]")
    parser.add_argument("--only", choices=FLOODS, help="one of the floods")
    parser.add_argument("--json", type=Path, help="write the figures into this file")
    parser.add_argument("--send", choices=FLOODS, help=argparse.SUPPRESS)
    parser.add_argument("--endpoint", help=argparse.SUPPRESS)
    parser.add_argument("--keys", type=Path, help=argparse.SUPPRESS)
    return parser.parse_args()


def send(flood: str, endpoint: str, keys: Path) -> None:
    """Floods until it is killed. Prints the number of messages sent and of replies so far, once a second."""
    import zenoh

    user, password = (keys / "password").read_text().strip().split(":", 1)
    config = zenoh.Config()
    for key, value in {
        "mode": "client",
        "connect/endpoints": [endpoint],
        "scouting/multicast/enabled": False,
        "transport/auth/usrpwd": {"user": user, "password": password},
        "transport/link/tls": {
            "root_ca_certificate": str(keys / "ca.pem"),
            "connect_certificate": str(keys / "cert.pem"),
            "connect_private_key": str(keys / "key.pem"),
            "enable_mtls": True,
        },
    }.items():
        config.insert_json5(key, json.dumps(value))
    replies = [0, 0]

    def take(reply: zenoh.Reply) -> None:
        replies[reply.ok is None] += 1

    with zenoh.open(config) as session:
        told_at = time.monotonic()
        for number in count():
            key, given = FLOODS[flood](number)
            if key.startswith("metrics"):
                session.put(f"lodestone/{RUN}/{key}", **given)
            else:
                session.get(f"lodestone/{RUN}/{key}", take, timeout=60, **given)
            if time.monotonic() > told_at + 1:
                told_at = time.monotonic()
                print(number, *replies, flush=True)


class Ring:
    """A router with keys, a learner, and an actor."""

    def __init__(self, binary: Path, folder: Path) -> None:
        self.folder = folder
        self.keys = folder / "keys"
        self.endpoint = f"quic/127.0.0.1:{free_port()}"
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self._binary = str(binary.resolve())

    def start(self) -> None:
        """Starts all members and waits for the first updates."""
        subprocess.run([self._binary, "keys", "new", str(self.keys)], check=True, capture_output=True)
        join = ["--connect", self.endpoint, "--preset", RUN]
        learner = ["learner", *join, "--run-dir", str(self.folder / "run"), "--steps", ENDLESS]
        self._launch("router", ["router", "--listen", self.endpoint])
        self._launch("learner", learner)
        self._launch("actor", ["actor", *join, "--id", "honest"])
        deadline = time.monotonic() + READY_S
        while len(self.updates()) < 3:
            if time.monotonic() > deadline:
                sys.exit(f"no update within {READY_S:.0f} s: see the logs in {self.folder}")
            time.sleep(0.1)

    def _launch(self, role: str, command: list[str]) -> None:
        command = ["setpriv", "--pdeathsig", "KILL", self._binary, *command, "--keys", str(self.keys / role)]
        with (self.folder / f"{role}.log").open("wb") as log:
            self.processes[role] = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)

    def stop(self) -> None:
        """Ends all members."""
        for process in reversed(self.processes.values()):
            process.terminate()
        for process in self.processes.values():
            try:
                process.wait(30)
            except subprocess.TimeoutExpired:
                process.kill()

    def updates(self) -> list[dict[str, Any]]:
        """Returns the learner's whole lines so far."""
        try:
            text = (self.folder / "run" / "metrics.jsonl").read_text()
        except FileNotFoundError:
            return []
        return [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]

    def status(self, role: str, field: str) -> int:
        """Returns a number of /proc/PID/status."""
        lines = Path(f"/proc/{self.processes[role].pid}/status").read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith(f"{field}:"))

    def cpu_s(self, role: str) -> float:
        """Returns the seconds that a member has computed so far."""
        fields = Path(f"/proc/{self.processes[role].pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def measure(self, seconds: float) -> dict[str, Any]:
        """Returns the speed over a time from now on, between the first and the last update in it, and what the learner
        counted meanwhile."""
        before = self.updates()
        threads = 0
        computed = {role: self.cpu_s(role) for role in ROLES}
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            time.sleep(0.2)
            threads = max(threads, *(self.status(role, "Threads") for role in ROLES))
        cores = {role: round((self.cpu_s(role) - computed[role]) / seconds, 2) for role in ROLES}
        lines = self.updates()
        fresh = lines[len(before) :]
        if len(fresh) >= 2:
            elapsed = fresh[-1]["elapsed_s"] - fresh[0]["elapsed_s"]
            speed = (fresh[-1]["n_env_steps"] - fresh[0]["n_env_steps"]) / elapsed
        else:
            speed = (lines[-1]["n_env_steps"] - before[-1]["n_env_steps"]) / seconds
        counted = {
            name: lines[-1][part][name] - before[-1][part][name]
            for part, name in (("bus", "queries_dropped_total"), ("ingest", "invalid_total"))
        }
        # The standstill of a disturbed ring is the longest time between two updates.
        times = [line["elapsed_s"] for line in (before[-1], *fresh)]
        pause = max((late - early for early, late in zip(times, times[1:])), default=seconds)
        return {"steps_per_s": round(speed), "longest_pause_s": round(pause, 1), "threads": threads, "cores": cores, **counted}


@contextmanager
def beside(command: list[str], processor: int) -> Iterator[subprocess.Popen[str]]:
    """Runs a command on one processor for as long as the block runs."""
    command = ["setpriv", "--pdeathsig", "KILL", *command]
    pinned = lambda: os.sched_setaffinity(0, {processor})  # noqa: E731
    # A session of its own, because Linux divides the processors among sessions first.
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, preexec_fn=pinned, start_new_session=True)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def figures(ring: Ring, seconds: float, chosen: list[str]) -> dict[str, dict[str, Any]]:
    """Measures each flood between the two speeds that it is compared with, so that other load affects all alike."""
    processor = max(os.sched_getaffinity(0))
    found: dict[str, dict[str, Any]] = {}

    def note(name: str, figure: dict[str, Any], basis: dict[str, Any] | None = None) -> dict[str, Any]:
        if basis is not None:
            figure = {"share": round(figure["steps_per_s"] / max(basis["steps_per_s"], 1), 2), **figure}
        found[name] = figure
        print(f"{name:45} {', '.join(f'{key} {value}' for key, value in figure.items())}", flush=True)
        return figure

    for flood in chosen:
        undisturbed = note(f"undisturbed before {flood}", ring.measure(seconds))
        with beside([sys.executable, "-c", "while True: pass"], processor):
            busy = note("beside a busy loop", ring.measure(seconds))
        command = [sys.executable, __file__, "--binary", ".", "--send", flood, "--endpoint", ring.endpoint]
        with beside([*command, "--keys", str(ring.keys / "actor")], processor) as flooder:
            said: list[str] = []
            threading.Thread(target=lambda: said.extend(flooder.stdout or ()), daemon=True).start()
            while not said and flooder.poll() is None:
                time.sleep(0.1)
            measured = ring.measure(seconds)
            sent, taken, refused = map(int, said[-1].split())
        note(flood, {**measured, "sent": sent, "answered": taken, "refused": refused}, busy)
        time.sleep(BACK_S)
        note(f"from {BACK_S:.0f} s after {flood}", ring.measure(seconds), undisturbed)
    return found


def main() -> int:
    """Measures, prints the figures, and returns 1 if a goal was missed."""
    args = arguments()
    if args.send:
        send(args.send, args.endpoint, args.keys)
    if not shutil.which("setpriv") or not os.access(args.binary, os.X_OK):
        print("setpriv (package util-linux) or the program is missing", file=sys.stderr)
        return 2
    folder = Path(tempfile.mkdtemp(prefix="lodestone-flood-"))
    ring = Ring(args.binary, folder)
    try:
        ring.start()
        found = figures(ring, args.seconds, [args.only] if args.only else list(FLOODS))
    finally:
        ring.stop()
    for role in ROLES:
        if "panicked" in (folder / f"{role}.log").read_text(errors="replace"):
            print(f"the {role} panicked: see {folder}")
            return 1
    shutil.rmtree(folder)
    if args.json:
        args.json.write_text(json.dumps(found, indent=2) + "\n")
    missed = [
        name
        for name, figure in found.items()
        if figure.get("share", 1) < (GOAL_AFTER if name.startswith("from") else GOAL_UNDER)
    ]
    print(f"below its goal: {', '.join(missed) or 'none'}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())

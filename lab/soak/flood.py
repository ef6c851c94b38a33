"""Floods a ring with the keys of an actor, and prints how much of its speed the ring keeps.

Usage: python3 -m lab.soak.flood --binary target/debug/lodestone [--seconds 20] [--only FLOOD]

A router with keys, a learner, and an actor train `smoke` on loopback. One processor is the flooder's. The speed
under a flood is compared with the speed beside a busy loop on that processor, and the speed from 5 s after the flood
with the speed when nothing disturbs the ring. docs/soak.md has the figures.
"""

import argparse
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

import zenoh

from ..ring import bus, records
from ..ring.checks import require_none, until
from ..ring.processes import ENDLESS, Process, demand, free_port, run

RUN = "smoke"
READY_S = 120.0
# After the end of a flood, the time until the ring must have its speed back.
BACK_S = 5.0
# Share of the speed beside a busy loop, and of the undisturbed speed afterwards, that the ring should keep.
GOAL_UNDER, GOAL_AFTER = 0.8, 0.95

# What a flooder sends without waiting for answers: arguments of `Session.get` or `Session.put`, by number of the message.
FLOODS: dict[str, Callable[[int], tuple[str, dict[str, Any]]]] = {
    "pulls": lambda number: ("weights/latest", {}),
    "pulls under invented names": lambda number: (f"weights/latest?session=flood-{number}", {}),
    "garbage": lambda number: (f"ingest/flood-{number % 7}", {"payload": b"garbage" + bytes(200)}),
    "metrics": lambda number: ("metrics/actor/flood", {"payload": b"garbage" + bytes(200)}),
}


def send(flood: str, endpoint: str, keys: str) -> None:
    """Floods until it is killed. Prints the number of messages sent and of replies so far, once a second."""
    replies = {"answered": 0, "refused": 0}

    def take(reply: zenoh.Reply) -> None:
        replies["answered" if reply.ok else "refused"] += 1

    with zenoh.open(bus.config(endpoint, Path(keys))) as session:
        told_at = time.monotonic()
        for number in count():
            key, given = FLOODS[flood](number)
            if key.startswith("metrics"):
                session.put(f"lodestone/{RUN}/{key}", **given)
            else:
                session.get(f"lodestone/{RUN}/{key}", take, timeout=60, **given)
            if time.monotonic() > told_at + 1:
                told_at = time.monotonic()
                print(f"sent {number}", replies, flush=True)


def start(binary: Path, folder: Path, endpoint: str) -> list[Process]:
    """Starts a router with keys, a learner, and an actor, and waits for the first updates."""
    run([binary, "keys", "new", folder / "keys"])
    join = ["--connect", endpoint, "--preset", RUN]
    own = {
        "router": ["--listen", endpoint],
        "learner": [*join, "--run-dir", str(folder / "run"), "--steps", str(ENDLESS)],
        "actor": [*join, "--id", "honest"],
    }
    started = [
        Process([str(binary), role, *words, "--keys", str(folder / "keys" / role)], folder / f"{role}.log")
        for role, words in own.items()
    ]
    until("the first updates", READY_S, lambda: len(records.entries(folder / "run")) >= 3)
    return started


def measure(run_dir: Path, seconds: float) -> dict[str, float]:
    """Returns the speed between the first and the last update of a time from now on, and what was counted in it."""
    before = records.entries(run_dir)
    time.sleep(seconds)
    lines = records.entries(run_dir)
    fresh = lines[len(before) :]
    if len(fresh) >= 2:
        elapsed = fresh[-1]["elapsed_s"] - fresh[0]["elapsed_s"]
        speed = (fresh[-1]["n_env_steps"] - fresh[0]["n_env_steps"]) / elapsed
    else:
        speed = (lines[-1]["n_env_steps"] - before[-1]["n_env_steps"]) / seconds
    # The standstill of a disturbed ring is the longest time between two updates.
    times = [line["elapsed_s"] for line in (before[-1], *fresh)]
    pause = max((late - early for early, late in zip(times, times[1:])), default=seconds)
    counts = {
        name: lines[-1][part][name] - before[-1][part][name]
        for part, name in (("bus", "queries_dropped_total"), ("ingest", "invalid_total"))
    }
    return {"steps_per_s": round(speed), "longest_pause_s": round(pause, 1), **counts}


@contextmanager
def beside(*code: str) -> Iterator[list[str]]:
    """Runs Python code on one processor for as long as the block runs, and yields the lines that it prints."""
    # A session of its own, because Linux divides the processors among sessions first.
    own = ["setpriv", "--pdeathsig", "KILL", "setsid", "taskset", "--cpu-list", str(max(os.sched_getaffinity(0)))]
    process = subprocess.Popen([*own, sys.executable, "-c", *code], stdout=subprocess.PIPE, text=True)
    said: list[str] = []
    threading.Thread(target=lambda: said.extend(process.stdout or ()), daemon=True).start()
    try:
        yield said
    finally:
        process.kill()
        process.wait()


def judge(flood: str, folder: Path, endpoint: str, seconds: float) -> Iterator[str]:
    """Measures a flood between the two speeds that it is compared with, so that other load affects all alike."""

    def note(name: str, more: str = "") -> float:
        found = measure(folder / "run", seconds)
        print(f"{name:45} {', '.join(f'{key} {value}' for key, value in found.items())} {more}", flush=True)
        return found["steps_per_s"]

    undisturbed = note(f"undisturbed before {flood}")
    with beside("while True: pass"):
        busy = note("beside a busy loop")
    code = "import sys; from lab.soak.flood import send; send(*sys.argv[1:])"
    with beside(code, flood, endpoint, str(folder / "keys" / "actor")) as said:
        until("the flooder sends", READY_S, lambda: list(said))
        under = note(flood) / max(busy, 1)
        print(said[-1].strip(), flush=True)
    time.sleep(BACK_S)
    after = note(f"from {BACK_S:.0f} s after {flood}") / max(undisturbed, 1)
    for name, share, goal in (("under", under, GOAL_UNDER), ("after", after, GOAL_AFTER)):
        print(f"{name} {flood}: {share:.2f} of the speed, the goal is {goal}")
        if share < goal:
            yield f"{name} {flood}"


def main() -> int:
    """Measures, prints the figures, and returns 1 if a goal was missed."""
    parser = argparse.ArgumentParser(prog="python3 -m lab.soak.flood", description=__doc__.splitlines()[0])
    parser.add_argument("--binary", type=Path, required=True, help="the program lodestone")
    parser.add_argument("--seconds", type=float, default=20.0, help="length of each measurement [default: 20]")
    parser.add_argument("--only", choices=FLOODS, help="one of the floods")
    args = parser.parse_args()
    demand(args.binary, {"setpriv": "util-linux", "taskset": "util-linux"})
    folder, endpoint = Path(tempfile.mkdtemp(prefix="lodestone-flood-")), f"quic/127.0.0.1:{free_port()}"
    print(f"runs and logs are in {folder}")
    processes = start(args.binary.resolve(), folder, endpoint)
    floods = [args.only] if args.only else FLOODS
    missed = [miss for flood in floods for miss in judge(flood, folder, endpoint, args.seconds)]
    for process in reversed(processes):
        process.end(30)
    require_none(panic for process in processes if (panic := process.panic()))
    shutil.rmtree(folder)
    print(f"below its goal: {', '.join(missed) or 'none'}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())

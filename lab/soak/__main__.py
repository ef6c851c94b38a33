#!/usr/bin/env python3
"""Kills, stops, disconnects, and restarts the members of a ring at random, and checks what was lost.

Usage: python lab/soak --binary target/debug/lodestone [--minutes 1] [--seed S] [--dir DIR] [--json FILE]

Needs the Python package eclipse-zenoh (pip install -r deploy/examples/requirements.txt) and `setpriv` from util-linux.
All processes run on loopback and end with this script, even if it is killed. docs/soak.md describes the checks. The
last line counts the checks. The exit code is 0 if all passed.
"""

from __future__ import annotations

import argparse
import asyncio
import importlib.util
import json
import math
import os
import random
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Awaitable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from checks import Tally, require
from members import has_panicked

if TYPE_CHECKING:
    from faults import Faults, Record
    from ring import Ring

# Minimum rates of faults: per hour, and per minute in a short run, where the first minute weighs more.
FAULTS_AN_HOUR = 500
FAULTS_A_MINUTE = 15
SHORT_MIN = 5.0

LEARNER_BACK_S = 10.0

# A run of at least this many minutes ends with a phase without faults, in which memory must not grow.
LONG_MIN = 10.0
CALM_S = 300.0

PROGRESS_S = 10.0


def arguments() -> argparse.Namespace:
    """Parses the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--binary", type=Path, required=True, help="the program lodestone")
    injected = "how long faults are injected [default: 1]; from 10 on, 5 calm ones follow"
    parser.add_argument("--minutes", type=float, default=1.0, help=injected)
    parser.add_argument("--seed", type=int, help="of the faults and of the trainings [default: a random one]")
    parser.add_argument("--dir", type=Path, help="keep runs and logs in this folder, which must not be there yet")
    parser.add_argument("--json", type=Path, help="write the figures into this file")
    parser.add_argument("--only", choices=("ring", "lockstep"), help="one of the two parts")
    parser.add_argument("--lockstep-kills", type=int, default=4, help="kills of the run in lockstep [default: 4]")
    return parser.parse_args()


def lacks(args: argparse.Namespace) -> list[str]:
    """Returns the unmet requirements as messages."""
    found = []
    if not os.access(args.binary, os.X_OK) or args.binary.is_dir():
        found.append(f"{args.binary} is no program: build it with `cargo build`")
    if not shutil.which("setpriv"):
        found.append("setpriv is missing (package util-linux)")
    if importlib.util.find_spec("zenoh") is None:
        found.append("the Python package eclipse-zenoh is missing (pip install -r deploy/examples/requirements.txt)")
    if args.dir and args.dir.exists():
        found.append(f"{args.dir} is there already: name another folder")
    if args.minutes <= 0:
        found.append("--minutes must be above 0")
    if args.lockstep_kills < 1:
        found.append("--lockstep-kills must be at least 1")
    return found


async def attempt(tally: Tally, name: str, action: Awaitable[object]) -> bool:
    """Runs an async action as a check and returns whether it passed."""
    try:
        tally.passed(name, await action)
    except Exception as error:
        tally.failed(name, error)
        return False
    return True


async def show_progress(ring: Ring, faults: Faults) -> None:
    """Prints a progress line every ten seconds."""
    began = time.monotonic()
    while True:
        await asyncio.sleep(PROGRESS_S)
        updates = [life.updates[-1] for life in ring.learner_lives if life.updates]
        steps = updates[-1]["n_env_steps"] if updates else 0
        hurt = sorted(name for member in ring.members for name in member.hurt)
        back = faults.record.learner_back_s
        print(
            f"[{time.monotonic() - began:5.0f} s] {faults.record.n_faults} faults, {len(back)} kills of the learner "
            f"(back in at most {max(back, default=0):.1f} s), {steps} steps, now: {', '.join(hurt) or 'none'}",
            flush=True,
        )


async def disturb(ring: Ring, faults: Faults, minutes: float, tally: Tally) -> bool:
    """Starts the ring, injects faults, lets it settle, and stops it. Returns False if the ring did not start."""
    from settle import all_work, calm, nothing_is_lost

    if not await attempt(tally, "the ring starts", ring.start()):
        return False
    rate = FAULTS_A_MINUTE if minutes <= SHORT_MIN else FAULTS_AN_HOUR / 60
    progress = asyncio.create_task(show_progress(ring, faults))
    try:
        await faults.inject(60 * minutes, math.ceil(rate * minutes))
    finally:
        progress.cancel()
    await attempt(tally, "everybody works after the last fault", all_work(ring))
    if minutes >= LONG_MIN:
        await attempt(tally, "the ring works on when there is no fault", calm(ring, CALM_S))
    await attempt(tally, "a learner that ends well loses nothing it acknowledged", nothing_is_lost(ring))
    await attempt(tally, "everything ends well after SIGTERM", ring.stop())
    return True


def judge(ring: Ring, faults: Faults, binary: Path, tally: Tally) -> dict[str, Any]:
    """Checks the results and returns the figures."""
    import reconcile
    import records

    record = faults.record
    # Each fault may have cost answers, and so may the start, the stops in between, and the end.
    sums = reconcile.balance(ring.learner_lives, ring.listener, ring.actors, record.n_faults + 3)
    tally.check("all faults were survived", lambda: survived(record))
    tally.check("the learner is back in less than 10 s", lambda: is_back_soon(record.learner_back_s))
    tally.check("nobody ended by itself or panicked", lambda: no_accidents(ring))
    tally.check("memory stays bounded", ring.memory.is_bounded)
    tally.check("no step is lost but after a checkpoint", lambda: records.steps_add_up(ring.learner_lives))
    tally.check("every checkpoint loads", lambda: checkpoints_load(ring, binary))
    tally.check("eval.db is whole", lambda: records.database_is_whole(ring.run_dir / "eval.db"))
    tally.check("no line of metrics.jsonl is broken", ring.lines.all_whole)
    tally.check("the learner gives each trajectory one verdict", lambda: reconcile.verdicts_add_up(ring.learner_lives))
    tally.check("actors account for each step", lambda: reconcile.actors_add_up(ring.listener, ring.actors))
    tally.check("both ends agree", lambda: reconcile.both_ends_agree(sums))
    tally.check("clean ends save all", lambda: reconcile.clean_ends_save_all(ring.learner_lives))
    roles = ring.memory.samples
    return {
        "n_faults": record.n_faults,
        "faults": dict(sorted(record.injected.items())),
        "n_kills_in_a_save": record.n_kills_in_a_save,
        "learner_back_s": spread(record.learner_back_s),
        "learner_back_after_sigterm_s": spread(record.learner_restart_back_s),
        "updates_again_after_router_restart_s": spread(record.router_back_s),
        "memory_mb": {role: round(ring.memory.most_mb(role), 1) for role in roles},
        "calm_memory_slope_mb_per_minute": {
            role: round(growth, 3) for role, growth in ring.memory.slopes_mb_per_minute().items()
        },
        "processes": {member.name: len(member.lives) for member in ring.members},
        "balance": vars(sums),
    }


def survived(record: Record) -> str:
    """Fails if the ring did not recover from a fault."""
    require(not record.failures, "; ".join(record.failures))
    return ", ".join(f"{n} {name}" for name, n in sorted(record.injected.items()))


def is_back_soon(seconds: list[float]) -> str:
    """Fails if the learner took too long to accept its next trajectory."""
    require(seconds, "it was never killed")
    require(max(seconds) < LEARNER_BACK_S, f"{max(seconds):.1f} s after a kill -9")
    about = spread(seconds)
    return f"{about['min']} to {about['max']} s, median {about['median']} s, {about['n']} kills"


def spread(seconds: list[float]) -> dict[str, float]:
    """Summarizes a list of times."""
    if not seconds:
        return {"n": 0}
    low, middle, high = min(seconds), statistics.median(seconds), max(seconds)
    return {"n": len(seconds), "min": round(low, 2), "median": round(middle, 2), "max": round(high, 2)}


def no_accidents(ring: Ring) -> str:
    """Fails if a process exited on its own or any log reports a panic."""
    require(not ring.accidents, "; ".join(map(str, ring.accidents[:3])))
    lives = [life for member in ring.members for life in member.lives]
    panics = [f"{life.log.name}: {line}" for life in lives if (line := has_panicked(life.log))]
    require(not panics, "; ".join(panics[:3]))
    return f"{len(lives)} processes"


def checkpoints_load(ring: Ring, binary: Path) -> str:
    """Checks that the program evaluates the newest checkpoint, all files are intact, and no partial ones are left."""
    import records

    saved = records.checkpoints(ring.run_dir)
    require(saved, "there is none")
    for path in saved.values():
        records.checkpoint_is_whole(path)
    left_over = records.cut_short(ring.run_dir)
    require(not left_over, f"left over: {', '.join(path.name for path in left_over)}")
    newest = saved[max(saved)]
    command = ["setpriv", "--pdeathsig", "KILL", str(binary), "eval", "--checkpoint", str(newest)]
    command += ["--episodes", "1", "--threads", "1", "--json"]
    told = subprocess.run(command, capture_output=True, timeout=300, check=False)
    require(told.returncode == 0, f"eval ended with {told.returncode}: {told.stderr.decode(errors='replace')[-400:]}")
    json.loads(told.stdout)
    return f"{len(saved)} of them, newest {newest.name}"


def show(figures: dict[str, Any]) -> None:
    """Prints the summary table."""
    print()
    for name, value in figures.items():
        text = ", ".join(f"{key} {number}" for key, number in value.items()) if isinstance(value, dict) else value
        print(f"{name:38} {text}")


async def soak(args: argparse.Namespace, folder: Path, seed: int) -> Tally:
    """Runs both parts, or the one selected by `--only`."""
    from faults import Faults
    from lockstep import ends_with_the_same_bytes
    from ring import Ring

    tally = Tally()
    figures: dict[str, Any] = {"seed": seed, "minutes": args.minutes}
    if args.only != "lockstep":
        ring = Ring(args.binary.resolve(), folder / "ring", seed)
        faults = Faults(ring, seed)
        try:
            if await disturb(ring, faults, args.minutes, tally):
                figures |= judge(ring, faults, args.binary.resolve(), tally)
        finally:
            await faults.cancel()
            await ring.close()
    if args.only != "ring":
        same = ends_with_the_same_bytes(args.binary.resolve(), folder / "lockstep", seed, args.lockstep_kills)
        await attempt(tally, "lockstep ends with the same bytes after kills", same)
    figures["checks"] = tally.said
    show({name: value for name, value in figures.items() if name != "checks"})
    if args.json:
        args.json.write_text(json.dumps(figures, indent=2) + "\n")
    return tally


async def until_told_to_stop(args: argparse.Namespace, folder: Path, seed: int) -> Tally:
    """Like `soak`, but SIGTERM and SIGINT cancel it after cleaning up its processes."""
    task = asyncio.current_task()
    assert task is not None, "it runs in a task"
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, task.cancel)
    return await soak(args, folder, seed)


def main() -> int:
    """Runs all checks and returns the exit code."""
    args = arguments()
    if missing := lacks(args):
        print("\n".join(missing), file=sys.stderr)
        return 2
    seed = args.seed if args.seed is not None else random.SystemRandom().randrange(1 << 31)
    folder = args.dir.resolve() if args.dir else Path(tempfile.mkdtemp(prefix="lodestone-soak-"))
    print(f"seed {seed}, {args.minutes:g} minutes, in {folder}", flush=True)
    keep = args.dir is not None
    try:
        tally = asyncio.run(until_told_to_stop(args, folder, seed))
        keep = keep or tally.n_failed > 0
    except asyncio.CancelledError:
        print("ended by a signal", file=sys.stderr)
        return 143
    finally:
        if not keep:
            shutil.rmtree(folder, ignore_errors=True)
        else:
            print(f"runs and logs are in {folder}", flush=True)
    print(tally.closing_line())
    return 1 if tally.n_failed else 0


if __name__ == "__main__":
    sys.exit(main())

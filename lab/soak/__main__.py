"""Kills, stops, disconnects, and restarts the members of a ring at random, and checks what was lost.

Usage: python3 -m lab.soak --binary target/debug/lodestone [--minutes 1] [--seed S] [--patience X] [--dir DIR]

All processes run on loopback and end with this script, even if it is killed. The last line counts the checks. The exit
code is 0 if all passed.
"""

import argparse
import asyncio
import json
import math
import random
import shutil
import signal
import statistics
import sys
import tempfile
from pathlib import Path

from ..ring import records
from ..ring.checks import Patience, Tally, require
from ..ring.processes import demand, run
from . import account, settle
from .faults import Faults
from .lockstep import ends_with_the_same_bytes
from .ring import INGEST_QUEUE, N_ACTORS, N_OUTSTANDING, Ring

# Minimum rates of faults: per hour, and per minute in a short run, where the first minute weighs more.
FAULTS_AN_HOUR = 500
FAULTS_A_MINUTE = 15
SHORT_MIN = 5.0

LEARNER_BACK_S = 10.0

# A run of at least this many minutes ends with a phase without faults, in which memory must not grow.
LONG_MIN = 10.0
CALM_S = 300.0


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python3 -m lab.soak", description=__doc__.splitlines()[0])
    parser.add_argument("--binary", type=Path, required=True, help="the program lodestone")
    injected = "how long faults are injected [default: 1]; from 10 on, 5 calm ones follow"
    parser.add_argument("--minutes", type=float, default=1.0, help=injected)
    parser.add_argument("--seed", type=int, help="of the faults and of the trainings [default: a random one]")
    parser.add_argument("--patience", type=float, default=1.0, help="factor on all time limits [default: 1]")
    parser.add_argument("--dir", type=Path, help="keep runs and logs in this folder, which must not be there yet")
    parser.add_argument("--only", choices=("ring", "lockstep"), help="one of the two parts")
    parser.add_argument("--lockstep-kills", type=int, default=4, help="kills of the run in lockstep [default: 4]")
    args = parser.parse_args()
    if args.dir and args.dir.exists():
        parser.error(f"{args.dir} is there already: name another folder")
    if args.minutes <= 0 or args.lockstep_kills < 1:
        parser.error("--minutes must be above 0, and --lockstep-kills at least 1")
    return args


async def disturb(ring: Ring, faults: Faults, minutes: float, tally: Tally) -> bool:
    """Starts the ring, injects faults, lets it settle, and stops it. Returns False if the ring did not start."""
    if not await tally.attempt("the ring starts", ring.start()):
        return False
    rate = FAULTS_A_MINUTE if minutes <= SHORT_MIN else FAULTS_AN_HOUR / 60
    await faults.inject(60 * minutes, math.ceil(rate * minutes))
    await tally.attempt("everybody works after the last fault", settle.all_work(ring))
    if minutes >= LONG_MIN:
        await tally.attempt("the ring works on when there is no fault", settle.calm(ring, CALM_S))
    await tally.attempt("a learner that ends well loses nothing it acknowledged", settle.nothing_is_lost(ring))
    await tally.attempt("everything ends well after SIGTERM", ring.stop())
    return True


def judge(ring: Ring, faults: Faults, binary: Path, tally: Tally) -> None:
    """Checks the results."""
    lives = ring.learner_lives
    # The counts of a line are read one at a time, and a verdict may happen in between.
    least = -N_ACTORS * N_OUTSTANDING
    verdicts = lambda: records.verdicts_add_up(lives, least, INGEST_QUEUE)  # noqa: E731
    tally.check("all faults were survived", faults.were_survived)
    back_s = LEARNER_BACK_S * Patience.factor
    tally.check(f"the learner is back in less than {back_s:g} s", lambda: is_back_soon(faults, back_s))
    tally.check("nobody ended by itself or panicked", lambda: no_accidents(ring))
    tally.check("memory stays bounded", ring.memory.is_bounded)
    tally.check("no step is lost but after a checkpoint", lambda: account.steps_add_up(lives))
    tally.check("every checkpoint loads", lambda: checkpoints_load(ring, binary))
    tally.check("eval.db is whole", lambda: records.database_is_whole(ring.run_dir))
    tally.check("no line of metrics.jsonl is broken", ring.lines.all_whole)
    tally.check("the learner gives each trajectory one verdict", verdicts)
    tally.check("actors account for each step", lambda: account.actors_add_up(ring))
    tally.check("both ends agree", lambda: account.both_ends_agree(ring, faults.n_injected))
    tally.check("clean ends save all", lambda: account.clean_ends_save_all(lives))


def is_back_soon(faults: Faults, limit_s: float) -> str:
    """Fails if the learner took longer to accept its next trajectory after a kill."""
    seconds = faults.back_s["kill learner"]
    require(seconds, "it was never killed")
    require(max(seconds) < limit_s, f"{max(seconds):.1f} s after a kill -9")
    return "; ".join(
        f"{len(back)} {name}: {min(back):.2f} to {max(back):.2f} s, median {statistics.median(back):.2f} s"
        for name, back in faults.back_s.items()
    )


def no_accidents(ring: Ring) -> str:
    """Fails if a process exited on its own or any log reports a panic."""
    require(not ring.accidents, "; ".join(ring.accidents[:3]))
    processes = [process for member in ring.members for process in member.processes]
    panics = [panic for process in processes if (panic := process.panic())]
    require(not panics, "; ".join(panics[:3]))
    return f"{len(processes)} processes"


def checkpoints_load(ring: Ring, binary: Path) -> str:
    """Checks that all checkpoints are intact, and that the program evaluates the newest."""
    saved = records.checkpoints_are_whole(ring.run_dir)
    newest = saved[max(saved)]
    json.loads(run([binary, "eval", "--checkpoint", newest, "--episodes", "1", "--threads", "1", "--json"]))
    return f"{len(saved)} of them, newest {newest.name}"


async def soak(args: argparse.Namespace, folder: Path, seed: int) -> Tally:
    """Runs both parts, or the one selected by `--only`. SIGTERM and SIGINT cancel it, and it ends its processes."""
    task, binary = asyncio.current_task(), args.binary.resolve()
    assert task is not None, "it runs in a task"
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, task.cancel)
    tally = Tally()
    if args.only != "lockstep":
        ring = Ring(binary, folder / "ring", seed)
        faults = Faults(ring, seed)
        try:
            if await disturb(ring, faults, args.minutes, tally):
                judge(ring, faults, binary, tally)
        finally:
            await faults.cancel()
            await ring.close()
    if args.only != "ring":
        same = ends_with_the_same_bytes(binary, folder / "lockstep", seed, args.lockstep_kills)
        await tally.attempt("lockstep ends with the same bytes after kills", same)
    return tally


def main() -> int:
    """Runs all checks and returns the exit code."""
    args = arguments()
    Patience.factor = args.patience
    demand(args.binary, {"setpriv": "util-linux"})
    seed = args.seed if args.seed is not None else random.SystemRandom().randrange(1 << 31)
    folder = args.dir.resolve() if args.dir else Path(tempfile.mkdtemp(prefix="lodestone-soak-"))
    print(f"seed {seed}, {args.minutes:g} minutes, in {folder}", flush=True)
    keep = args.dir is not None
    try:
        tally = asyncio.run(soak(args, folder, seed))
        keep = keep or tally.n_failed > 0
    except asyncio.CancelledError:
        print("ended by a signal", file=sys.stderr)
        return 143
    finally:
        if not keep:
            shutil.rmtree(folder, ignore_errors=True)
        else:
            print(f"runs and logs are in {folder}", flush=True)
    return tally.close()


if __name__ == "__main__":
    sys.exit(main())

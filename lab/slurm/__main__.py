"""Trains on real Slurm clusters whose controllers and nodes run in temporary namespaces on this machine.

Usage: python3 -m lab.slurm --binary target/debug/lodestone [--patience X] [--only TEXT]

Needs root and the programs of Debian's slurm-wlm, munge, and iproute2. Touches nothing outside its namespaces: its
mounts, sockets, and files disappear when it exits, even if it is killed.

Two parts run in parallel, each on its own cluster, because most of the time goes to Slurm, which checks nodes and time
limits every few seconds. Each line starts with the name of its part. The last line counts the checks.
"""

import argparse
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

from ..ring.checks import Patience, Tally
from ..ring.processes import demand, plain_environment
from . import commands, faults
from .cluster import PROGRAMS, Cluster, isolate
from .conf import mount_tmpfs
from .training import Check, Training

SCRATCH = Path("/run")
"""Covered by an empty file system in the test's namespace."""

PARTS: dict[str, list[Check]] = {"faults": faults.CHECKS, "others": commands.CHECKS}
"""What runs at the same time; within a part each check may need what the one before it left behind."""


def main() -> int:
    """Checks the requirements, then runs each part in its own namespaces."""
    parser = argparse.ArgumentParser(prog="python3 -m lab.slurm", description=__doc__.splitlines()[0])
    parser.add_argument("--binary", type=Path, required=True, help="the program lodestone")
    parser.add_argument("--only", default="", help="only the checks whose name contains this, and the launch before them")
    parser.add_argument("--patience", type=float, default=1.0, help="factor on all time limits [default: 1]")
    parser.add_argument("--isolated", choices=PARTS, help=argparse.SUPPRESS)
    args = parser.parse_args()
    os.environ["PATH"] += os.pathsep + os.pathsep.join(["/usr/sbin", "/sbin"])
    Patience.factor = args.patience
    if args.isolated:
        return isolated(args.isolated, args.binary, args.only)
    demand(args.binary, PROGRAMS, [] if os.geteuid() == 0 else ["only root makes namespaces and mounts: use sudo"])
    again = ["--binary", str(args.binary.resolve()), "--only", args.only, "--patience", str(args.patience)]
    with ThreadPoolExecutor() as pool:
        parts = list(pool.map(lambda name: play(name, again), PARTS))
    said = [word for _, words in parts for word in words]
    print(f"{said.count('ok')} passed, {said.count('FAILED')} failed")
    return max(code for code, _ in parts)


def play(name: str, again: list[str]) -> tuple[int, list[str]]:
    """Runs a part in its own namespaces and prints its output. Returns its exit code and the first word of each line."""
    command = [sys.executable, "-m", "lab.slurm", *again, "--isolated", name]
    # `unshare` ignores SIGTERM, so let the kernel kill it, and everything in its namespaces, when this process exits.
    bound = ["setpriv", "--pdeathsig", "KILL", *isolate(command)]
    words: list[str] = []
    with subprocess.Popen(bound, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as process:
        for line in process.stdout or ():
            words += line.split()[:1]
            # One write per line, so that the output of the parts does not mix within a line.
            sys.stdout.write(f"{name} | {line}")
            sys.stdout.flush()
    return process.returncode, words


def isolated(part: str, binary: Path, only: str) -> int:
    """Runs the checks of one part on a cluster and returns the exit code."""
    kept = {name: value for name, value in plain_environment().items() if not name.startswith(("SLURM_", "SBATCH_"))}
    os.environ.clear()
    os.environ.update(kept)
    checks = chosen(PARTS[part], only)
    if not checks:
        return 0
    mount_tmpfs(SCRATCH)
    scratch = SCRATCH / "lodestone-slurm-test"
    cluster = Cluster(scratch / "cluster")
    # A name with spaces and a quote, which the scripts must handle.
    training = Training(cluster, binary, scratch / "the user's runs" / "smoke")
    # Each check relies on the state that the one before it left, so none is tried after a failure.
    tally = Tally(partial(show_logs, scratch), enough=1)
    try:
        cluster.start()
        for check in checks:
            tally.check(check.__name__, partial(check, training))
    finally:
        cluster.stop()
    return 1 if tally.n_failed else 0


def chosen(checks: list[Check], only: str) -> list[Check]:
    """Returns the checks whose name contains `only`, plus the first, which the others need."""
    some = [check for check in checks if only in check.__name__]
    return [checks[0], *some[some[0] is checks[0] :]] if some else []


def show_logs(scratch: Path, n_lines: int = 40) -> None:
    """Prints the end of every log."""
    logs = [log for log in scratch.rglob("logs/*.*") if log.suffix == ".log" or not log.with_suffix(".log").exists()]
    for log in sorted(logs):
        tail = log.read_text(encoding="utf-8", errors="replace").splitlines()[-n_lines:]
        print(f"--- {log.relative_to(scratch)}", *tail, sep="\n", flush=True)


if __name__ == "__main__":
    sys.exit(main())

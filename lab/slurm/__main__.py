#!/usr/bin/env python3
"""Trains on real Slurm clusters whose controllers and nodes run in temporary namespaces on this machine.

usage: python3 lab/slurm --binary target/debug/lodestone

Needs root and the programs of Debian's slurm-wlm, munge, and iproute2. Touches nothing outside its namespaces: its
mounts, sockets, and files disappear when it exits, even if it is killed.

Two parts run in parallel, each on its own cluster, because most of the time goes to Slurm, which checks nodes and time
limits every few seconds. Each line starts with the name of its part. The last line counts the checks.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import threading
import time
import traceback
from pathlib import Path

import cluster as clusters
import commands
import conf
import faults
import hetjob
from launched import Launched
from training import Check, Training

SCRATCH = Path("/run")
"""Covered by an empty file system in the test's namespace."""

NO_LOGS = ("checkpoints", "keys", "munge", "spool", "state")
"""Folders that --logs leaves out."""

PARTS: dict[str, list[Check]] = {"faults": faults.CHECKS, "others": [*commands.CHECKS, *hetjob.CHECKS]}
"""What runs at the same time; within a part each check may need what the one before it left behind."""

OUTCOMES = {True: "ok", False: "FAILED"}


def main() -> int:
    """Checks the requirements, then runs each part in its own namespaces."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", type=Path, required=True, help="the program lodestone")
    parser.add_argument("--logs", type=Path, help="keep all logs in this folder, which must not be there yet")
    parser.add_argument("--only", default="", help="only the checks whose name contains this, and the launch before them")
    parser.add_argument("--patience", type=float, default=1.0, help="factor on all time limits [default: 1]")
    parser.add_argument("--isolated", choices=PARTS, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.isolated:
        return isolated(args.isolated, args.binary, args.logs, args.only)
    if not os.access(args.binary, os.X_OK):
        parser.error(f"{args.binary} is no program: build it with `cargo build`")
    if args.logs is not None and args.logs.exists():
        parser.error(f"{args.logs} is there already: name another folder for --logs")
    if os.geteuid() != 0:
        parser.error("needs root, for namespaces and mounts: run it with sudo")
    missing = clusters.missing_programs()
    if missing:
        parser.error(f"lacks {', '.join(missing)}: install slurm-wlm, munge and iproute2")
    again = [sys.executable, __file__, "--binary", str(args.binary.resolve()), "--only", args.only]
    parts = {part: Part(part, again, args.logs, args.patience) for part in PARTS}
    codes = [part.wait() for part in parts.values()]
    said = [word for part in parts.values() for word in part.outcomes]
    print(f"{said.count(OUTCOMES[True])} passed, {said.count(OUTCOMES[False])} failed")
    return max(codes)


class Part:
    """A part that runs in its own namespaces. Its output is printed here."""

    def __init__(self, name: str, again: list[str], logs: Path | None, patience: float) -> None:
        self.name = name
        self.outcomes: list[str] = []
        command = [*again, "--isolated", name, *(["--logs", str(logs.resolve() / name)] if logs else [])]
        # `unshare` ignores SIGTERM, so let the kernel kill it, and everything in its namespaces, when this process
        # exits.
        bound = ["setpriv", "--pdeathsig", "KILL", *clusters.isolate(command)]
        environment = {**os.environ, "PATIENCE": str(patience), "PYTHONUNBUFFERED": "1"}
        self._process = subprocess.Popen(bound, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        self._printer = threading.Thread(target=self._print)
        self._printer.start()

    def wait(self) -> int:
        """Waits until the part has ended and returns its exit code."""
        self._printer.join()
        return self._process.wait()

    def _print(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self.outcomes += [word for word in OUTCOMES.values() if line.startswith(f"{word} ")]
            # One write per line, so that the output of the parts does not mix within a line.
            sys.stdout.write(f"{self.name} | {line}")
            sys.stdout.flush()


def isolated(part: str, binary: Path, logs: Path | None, only: str) -> int:
    """Runs the checks of one part on a cluster and returns the exit code."""
    for name in [name for name in os.environ if name.startswith(("LODESTONE_", "SLURM_", "SBATCH_"))]:
        del os.environ[name]
    checks = chosen(PARTS[part], only)
    if not checks:
        return 0
    os.environ["PATH"] += os.pathsep + os.pathsep.join(["/usr/sbin", "/sbin"])
    conf.mount_tmpfs(SCRATCH)
    scratch = SCRATCH / "lodestone-slurm-test"
    cluster = clusters.Cluster(scratch / "cluster")
    # A name with spaces and a quote, which the scripts must handle.
    training = Training(cluster, Launched(binary, scratch / "the user's runs" / "near-goal"))
    try:
        cluster.start()
        outcomes = in_turn(checks, training, scratch)
    finally:
        cluster.stop()
        if logs is not None:
            shutil.copytree(scratch, logs, ignore=lambda _, names: [name for name in names if name in NO_LOGS])
    for name, value in training.figures.items():
        print(f"{name}: {value:.2f}")
    return 0 if all(outcomes) else 1


def chosen(checks: list[Check], only: str) -> list[Check]:
    """Returns the checks whose name contains `only`, plus the first, which the others need."""
    some = [check for check in checks if only in check.__name__]
    return [checks[0], *some[some[0] is checks[0] :]] if some else []


def in_turn(checks: list[Check], training: Training, scratch: Path) -> list[bool]:
    """Returns whether each check passed. Each relies on the previous one's state, so a failure skips the rest."""
    outcomes: list[bool] = []
    for check in checks:
        if False in outcomes:
            print(f"{OUTCOMES[False]} {check.__name__}: not tried after the failure before it", flush=True)
            outcomes.append(False)
            continue
        began = time.monotonic()
        try:
            check(training)
        except Exception:  # Every failure is one to report, and the cluster must go down after it
            print(f"{OUTCOMES[False]} {check.__name__}", flush=True)
            traceback.print_exc(file=sys.stdout)
            show_logs(scratch)
            outcomes.append(False)
        else:
            print(f"{OUTCOMES[True]} {check.__name__} ({time.monotonic() - began:.1f} s)", flush=True)
            outcomes.append(True)
    return outcomes


def show_logs(scratch: Path, n_lines: int = 40) -> None:
    """Prints the end of every log."""
    logs = [log for log in scratch.rglob("logs/*.*") if log.suffix == ".log" or not log.with_suffix(".log").exists()]
    for log in sorted(logs):
        tail = log.read_text(encoding="utf-8", errors="replace").splitlines()[-n_lines:]
        print(f"--- {log.relative_to(scratch)}", *tail, sep="\n", flush=True)


if __name__ == "__main__":
    sys.exit(main())

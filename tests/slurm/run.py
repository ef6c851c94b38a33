#!/usr/bin/env python3
"""Trains on a real Slurm: a controller and three nodes in namespaces of this machine, which exist for this test alone.

usage: python3 tests/slurm/run.py --binary target/debug/lodestone

Needs root and the programs of Debian's slurm-wlm, munge and iproute2. Touches nothing outside its namespaces: whatever it
mounts, listens on or writes is gone when it ends, also when it is killed.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
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


def main() -> int:
    """Checks what is needed, then runs itself again in namespaces of its own."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", type=Path, required=True, help="the program lodestone")
    parser.add_argument("--logs", type=Path, help="keep all logs in this folder, which must not be there yet")
    parser.add_argument("--only", default="", help="only the checks whose name contains this, and the launch before them")
    parser.add_argument("--patience", type=float, default=1.0, help="factor on all time limits [default: 1]")
    parser.add_argument("--isolated", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.isolated:
        return isolated(args.binary, args.logs, args.only)
    if not os.access(args.binary, os.X_OK):
        parser.error(f"{args.binary} is no program: build it with `cargo build`")
    if args.logs is not None and args.logs.exists():
        parser.error(f"{args.logs} is there already: name another folder for --logs")
    if os.geteuid() != 0:
        parser.error("needs root, for namespaces and mounts: run it with sudo")
    missing = clusters.missing_programs()
    if missing:
        parser.error(f"lacks {', '.join(missing)}: install slurm-wlm, munge and iproute2")
    again = [sys.executable, __file__, "--binary", str(args.binary.resolve()), "--isolated", "--only", args.only]
    again += ["--logs", str(args.logs.resolve())] if args.logs else []
    sys.stdout.flush()
    # `unshare` is deaf to SIGTERM, so the kernel ends it, and all in its namespaces, when this process ends for any reason.
    bound = ["setpriv", "--pdeathsig", "KILL", *clusters.isolate(again)]
    return subprocess.run(bound, env={**os.environ, "PATIENCE": str(args.patience)}, check=False).returncode


def isolated(binary: Path, logs: Path | None, only: str) -> int:
    """Runs all checks on a cluster."""
    for name in [name for name in os.environ if name.startswith(("LODESTONE_", "SLURM_", "SBATCH_"))]:
        del os.environ[name]
    os.environ["PATH"] += os.pathsep + os.pathsep.join(["/usr/sbin", "/sbin"])
    conf.mount_tmpfs(SCRATCH)
    scratch = SCRATCH / "lodestone-slurm-test"
    cluster = clusters.Cluster(scratch / "cluster")
    # A name with spaces and a quote, which the scripts must survive.
    training = Training(cluster, Launched(binary, scratch / "the user's runs" / "near-goal"))
    together = Training(cluster, Launched(binary, scratch / "together"))
    try:
        cluster.start()
        outcomes = in_turn(chosen(commands.CHECKS, only), training, scratch)
        outcomes += in_turn(chosen(faults.CHECKS, only), training, scratch)
        outcomes += in_turn(chosen(hetjob.CHECKS, only), together, scratch)
    finally:
        cluster.stop()
        if logs is not None:
            shutil.copytree(scratch, logs, ignore=lambda _, names: [name for name in names if name in NO_LOGS])
    for name, value in {**training.figures, **together.figures}.items():
        print(f"{name}: {value:.2f}")
    print(f"{outcomes.count(True)} passed, {outcomes.count(False)} failed")
    return 0 if all(outcomes) else 1


def chosen(checks: list[Check], only: str) -> list[Check]:
    """The checks whose name contains `only`, and the first, which the others need."""
    some = [check for check in checks if only in check.__name__]
    return [checks[0], *some[some[0] is checks[0] :]] if some else []


def in_turn(checks: list[Check], training: Training, scratch: Path) -> list[bool]:
    """Whether each check passed; each needs what the one before it left behind, so none is tried after a failure."""
    outcomes: list[bool] = []
    for check in checks:
        if False in outcomes:
            print(f"FAILED {check.__name__}: not tried after the failure before it", flush=True)
            outcomes.append(False)
            continue
        began = time.monotonic()
        try:
            check(training)
        except Exception:  # Every failure is one to report, and the cluster must go down after it
            print(f"FAILED {check.__name__}", flush=True)
            traceback.print_exc(file=sys.stdout)
            show_logs(scratch)
            outcomes.append(False)
        else:
            print(f"ok {check.__name__} ({time.monotonic() - began:.1f} s)", flush=True)
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

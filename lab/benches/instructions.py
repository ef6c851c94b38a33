#!/usr/bin/env python3
"""Counts the instructions of the hot paths and reports changes of more than 5%.

Usage: python lab/benches/instructions.py BINARY [--update]

BINARY is the path printed by `cargo bench -p lab --bench hot_paths --no-run`. Needs valgrind. Each path runs for one
round and for three; half the difference is one round, without startup and setup. valgrind has no AVX-512, so the counts
are for AVX2. They are stored with the compiler version in instructions.json next to this script; --update rewrites the
file. The exit code is 1 if any count exceeds its limit.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

KEPT = Path(__file__).with_name("instructions.json")
PATHS = ("world", "features", "forward", "gradient")
LIMIT = 0.05


def instructions(binary: Path, path: str, rounds: int) -> int:
    """Returns the instruction count of the whole program."""
    with tempfile.TemporaryDirectory() as folder:
        out = f"--callgrind-out-file={folder}/out"
        command = ["valgrind", "--tool=callgrind", out, str(binary), path, str(rounds)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    found = re.search(r"Collected : (\d+)", done.stderr)
    if done.returncode != 0 or not found:
        sys.exit(f"{' '.join(command)} failed:\n{done.stderr[-2000:]}")
    return int(found[1])


def main() -> int:
    """Prints one line per path and returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("binary", type=Path, help="the bench hot_paths, built")
    parser.add_argument("--update", action="store_true", help="keep the new counts")
    args = parser.parse_args()
    found: dict[str, Any] = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    kept: dict[str, int] = found.get("instructions", {})
    rustc = subprocess.run(["rustc", "--version"], capture_output=True, text=True, check=True).stdout.strip()
    if kept and found.get("rustc") != rustc:
        print(f"counted with {rustc}, compared with {found.get('rustc')}: a change may be the compiler's", flush=True)
    counted: dict[str, int] = {}
    n_beyond = 0
    for path in PATHS:
        counted[path] = (instructions(args.binary, path, 3) - instructions(args.binary, path, 1)) // 2
        before = kept.get(path)
        change = counted[path] / before - 1 if before else 0.0
        is_beyond = before is not None and abs(change) > LIMIT
        n_beyond += is_beyond
        note = "  <- changed" if is_beyond else ""
        print(f"{path:10} {counted[path]:>14,} instructions a round, {change:+.1%}{note}", flush=True)
    if args.update:
        KEPT.write_text(json.dumps({"rustc": rustc, "instructions": counted}, indent=2) + "\n")
        return 0
    return 1 if n_beyond else 0


if __name__ == "__main__":
    sys.exit(main())

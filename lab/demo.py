#!/usr/bin/env python3
"""Makes the demo page: a static copy of three runs, which any web server can serve.

    python3 lab/demo.py target/demo [--binary PROGRAM]

One run learns goals of two to four blocks, one begins with the shipped policy and hardly changes it, and one learns a
structure that is not in the catalog. It takes some minutes.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
OWN = ROOT / "blueprints/examples/signpost.toml"

# One update at a rate that changes nothing: the page shows runs, and this one is the shipped policy as a run.
AS_IT_IS = ["--steps", "1", "--set", 'learner.optimizer.lr_schedule={kind="fixed"}', "--set", "learner.optimizer.learning_rate=1e-12"]
RUNS = {
    "learning": ["--set", "evaluator.every.steps=20000"],
    "shipped policy": ["--preset", "laptop", "--init-from", "pretrained", *AS_IT_IS, "--set", 'evaluator.last_splits=["validation"]'],
    "own structure": ["--blueprint", str(OWN), "--steps", "100000", "--set", "evaluator.every.steps=20000"],
}
# One that all of them can build, one that only the shipped policy can, and the own one.
GOALS = ["4_000", "16_002", str(OWN)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="the new folder of the copy")
    parser.add_argument("--binary", type=Path, default=ROOT / "target/release/lodestone")
    arguments = parser.parse_args()
    binary = arguments.binary.resolve()
    with tempfile.TemporaryDirectory() as scratch:
        for name, options in RUNS.items():
            subprocess.run([binary, "train", "--seed", "1", "--no-web", "--run-dir", name, *options], cwd=scratch, check=True)
        goals = [part for goal in GOALS for part in ("--blueprint", goal)]
        serve = [binary, "serve", *RUNS, "--export", arguments.folder.resolve(), *goals]
        subprocess.run(serve, cwd=scratch, check=True)


if __name__ == "__main__":
    main()

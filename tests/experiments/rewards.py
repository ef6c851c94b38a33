#!/usr/bin/env python3
"""Measures what rewards add to labels, with several seeds, and prints the table of docs/results.md.

    python3 tests/experiments/rewards.py runs/rewards --seeds 1 2 3

Goals of two to four blocks. An imitator learns from labels for 300 thousand steps. From its checkpoint, one run goes on
with rewards for 100 thousand steps, and one with labels for as many. A seed takes about fifteen minutes on two cores. What
is complete is not run again, and what was cut off begins anew. The program must have been built: cargo build --release.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

from run import ACTING, ROOT, cell

LABELED_STEPS, ALL_STEPS = 300_000, 400_000
# What makes labels of the rewards that the preset would go on with.
LABELS = {"weight": 1.0, "ppo_weight": 0.0, "kl_weight": 0.0}
STAGES = ("imitator", "further labels", "rewards")


def complete(program: Path, folder: Path, episodes: int, args: list[str]) -> None:
    """Trains into the folder and evaluates what was learned, unless there is a report; prints go to a file beside it."""
    report = folder / "report.json"
    if report.exists():
        return
    shutil.rmtree(folder, ignore_errors=True)
    folder.parent.mkdir(parents=True, exist_ok=True)
    print(f"{folder}: training", flush=True)
    with folder.with_suffix(".log").open("w") as log:
        train = [program, "train", *args, "--run-dir", folder, "--no-web"]
        subprocess.run(train, stdout=log, stderr=log, check=True)
    print(f"{folder}: evaluating", flush=True)
    evaluate = [program, "eval", "--checkpoint", folder, "--episodes", str(episodes), "--json"]
    told = subprocess.run(evaluate, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=True).stdout
    part = report.with_suffix(".part")
    part.write_bytes(told)
    part.rename(report)


def complete_seed(program: Path, out: Path, seed: int, episodes: int) -> None:
    """Makes the three runs of a seed, or those that are missing."""
    imitator, labels, rewards = (out / f"seed-{seed}" / stage.replace(" ", "-") for stage in STAGES)
    begin = ["--preset", "imitation-and-ppo", "--seed", str(seed), "--steps", str(LABELED_STEPS)]
    complete(program, imitator, episodes, begin)
    go_on = ["--resume", str(imitator), "--steps", str(ALL_STEPS)]
    complete(program, rewards, episodes, go_on)
    with_labels = [f"--set=learner.imitation.{key}={value}" for key, value in LABELS.items()]
    complete(program, labels, episodes, [*go_on, *with_labels])


def table(out: Path) -> str:
    """Markdown: a row for each stage and way of acting, with the mean of all seeds and their extremes."""
    lines = ["| | seeds | actions | success | steps |", "|---|---|---|---|---|"]
    for stage in STAGES:
        reports = [json.loads(path.read_text()) for path in sorted(out.glob(f"seed-*/{stage.replace(' ', '-')}/report.json"))]
        for acting, mode in ACTING.items():
            found: list[dict[str, Any]] = [report["summary"]["all"][mode] for report in reports]
            steps = [one["mean_steps"] for one in found]
            shown = f"{sum(steps) / len(steps):.1f} ({min(steps):.1f}–{max(steps):.1f})" if steps else "–"
            rate = cell([one["success"]["rate"] for one in found])
            lines.append(f"| {stage} | {len(found)} | {acting} | {rate} | {shown} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder of the runs")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--episodes", type=int, default=20, help="per blueprint and way of acting, at the end of a stage")
    parser.add_argument("--table", action="store_true", help="train nothing")
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/lodestone")
    args = parser.parse_args()
    for seed in args.seeds:
        if not args.table:
            complete_seed(args.program.resolve(), args.out, seed, args.episodes)
    print(table(args.out))


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Measures what rewards add to labels, with several seeds, and prints the table of docs/results.md.

    python3 tests/experiments/rewards.py runs/rewards --seeds 1 2 3

Three ways to spend one budget, goals of two to four blocks: the imitator after 300 thousand steps of labels, the same run
after 100 thousand more of rewards, and a run with labels for all 400 thousand. A seed takes about fifteen minutes on two
cores. What is complete is not run again. The program must have been built: cargo build --release.
"""

from __future__ import annotations

import argparse
import json
import subprocess
from pathlib import Path
from typing import Any

from run import ACTING, ROOT, cell

LABELED_STEPS, ALL_STEPS = 300_000, 400_000
STAGES = ("imitator", "further labels", "rewards")


def train(program: Path, folder: Path, *args: str) -> None:
    """Trains to its end; what it prints goes into a file beside the folder."""
    with folder.with_suffix(".log").open("a") as log:
        subprocess.run([program, "train", *args, "--no-web"], stdout=log, stderr=log, check=True)


def evaluate(program: Path, folder: Path, stage: str, episodes: int) -> None:
    """Writes the report of the newest weights, which are those of the stage."""
    report = folder.parent / f"{stage.replace(' ', '-')}.json"
    print(f"{folder.parent.name}: evaluating {stage}", flush=True)
    command = [program, "eval", "--checkpoint", folder, "--episodes", str(episodes), "--json"]
    told = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=True).stdout
    part = report.with_suffix(".part")
    part.write_bytes(told)
    part.rename(report)


def complete(program: Path, out: Path, seed: int, episodes: int) -> None:
    """Makes the three reports of a seed, or those that are missing."""
    of_seed = out / f"seed-{seed}"
    of_seed.mkdir(parents=True, exist_ok=True)
    for stage, preset, n_steps in (
        ("imitator", "imitation-and-ppo", LABELED_STEPS),
        ("rewards", "imitation-and-ppo", ALL_STEPS),
        ("further labels", "imitation-only", ALL_STEPS),
    ):
        if (of_seed / f"{stage.replace(' ', '-')}.json").exists():
            continue
        folder = of_seed / preset
        print(f"{of_seed.name}: training for {stage}", flush=True)
        begun = (folder / "config.toml").exists()
        of_new = ["--preset", preset, "--seed", str(seed), "--run-dir", str(folder)]
        start = ["--resume", str(folder)] if begun else of_new
        train(program, folder, *start, "--steps", str(n_steps))
        evaluate(program, folder, stage, episodes)


def table(out: Path) -> str:
    """Markdown: a row for each stage and way of acting, with the mean of all seeds and their extremes."""
    lines = ["| | seeds | actions | success | steps |", "|---|---|---|---|---|"]
    for stage in STAGES:
        reports = [json.loads(path.read_text()) for path in sorted(out.glob(f"seed-*/{stage.replace(' ', '-')}.json"))]
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
            complete(args.program.resolve(), args.out, seed, args.episodes)
    print(table(args.out))


if __name__ == "__main__":
    main()

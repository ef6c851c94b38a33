#!/usr/bin/env python3
"""Measures how much training with rewards adds to labels, over several seeds, and prints the table in docs/results.md.

    python3 tests/experiments/rewards.py runs/rewards --seeds 1 2 3

Goals have two to four blocks. An imitator learns from labels for 300 thousand steps. From its checkpoint, one run
continues with rewards for 100 thousand steps, and another with labels for the same number. A seed takes about fifteen
minutes on two cores. Complete runs are skipped, and interrupted runs start over. Build the program first:
cargo build --release.
"""

from __future__ import annotations

import argparse
import json
import shutil
import statistics
import subprocess
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
ACTING = {"greedy": "mode", "sampled": "sampled"}
LABELED_STEPS, ALL_STEPS = 300_000, 400_000
# Settings that keep training on labels where the preset would switch to rewards.
LABELS = {"weight": 1.0, "ppo_weight": 0.0, "kl_weight": 0.0}
STAGES = ("imitator", "further labels", "rewards")


def train(program: Path, folder: Path, args: list[str]) -> None:
    """Trains a run, with its output in a log file next to the folder.

    An interrupted `train` saves its state and exits with 0, so the steps decide whether the run is complete.
    """
    with folder.with_suffix(".log").open("a") as log:
        subprocess.run([program, "train", *args, "--no-web"], stdout=log, stderr=log, check=True)
    n_env_steps = tomllib.loads((folder / "config.toml").read_text())["n_env_steps"]
    steps = [int(path.name.removeprefix("step-")) for path in folder.glob("checkpoints/step-*")]
    if max(steps, default=0) < n_env_steps:
        raise SystemExit(f"the training in {folder} was interrupted; run the script again")


def cell(found: list[float]) -> str:
    """Formats the mean in percent, with the extremes if they differ."""
    if not found:
        return "–"
    mean, least, most = (f"{100 * value:.1f}" for value in (statistics.mean(found), min(found), max(found)))
    return f"{mean}%" if least == most else f"{mean}% ({least}–{most})"


def complete(program: Path, folder: Path, episodes: int, args: list[str]) -> None:
    """Trains and evaluates a run unless its report exists. Training output goes to a log file next to the folder."""
    report = folder / "report.json"
    if report.exists():
        return
    shutil.rmtree(folder, ignore_errors=True)
    folder.parent.mkdir(parents=True, exist_ok=True)
    print(f"{folder}: training", flush=True)
    train(program, folder, [*args, "--run-dir", str(folder)])
    print(f"{folder}: evaluating", flush=True)
    evaluate = [program, "eval", "--checkpoint", folder / "checkpoints", "--episodes", str(episodes), "--json"]
    told = subprocess.run(evaluate, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=True).stdout
    part = report.with_suffix(".part")
    part.write_bytes(told)
    part.rename(report)


def complete_seed(program: Path, out: Path, seed: int, episodes: int) -> None:
    """Completes the three runs of a seed."""
    imitator, labels, rewards = (out / f"seed-{seed}" / stage.replace(" ", "-") for stage in STAGES)
    begin = ["--preset", "imitation-and-ppo", "--seed", str(seed), "--steps", str(LABELED_STEPS)]
    complete(program, imitator, episodes, begin)
    go_on = ["--resume", str(imitator), "--steps", str(ALL_STEPS)]
    complete(program, rewards, episodes, go_on)
    with_labels = [f"--set=learner.imitation.{key}={value}" for key, value in LABELS.items()]
    complete(program, labels, episodes, [*go_on, *with_labels])


def table(out: Path) -> str:
    """Returns a Markdown table with a row per stage and greedy or sampled actions: mean and extremes over all seeds."""
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

#!/usr/bin/env python3
"""Runs the experiments in docs/experiments.md and prints their tables.

    python3 tests/experiments/run.py runs/experiments                      # all, seed 1
    python3 tests/experiments/run.py runs/experiments compact no-attention --seeds 1 2 3
    python3 tests/experiments/run.py runs/experiments --table              # only tables of existing runs, no training

Each experiment trains the preset `compact` with one change. A run takes 15 to 85 minutes on two cores. Complete
runs are skipped, and interrupted runs resume from their newest checkpoint. `imitator` and `labels-only` begin with
the labels of `compact`: the first evaluates its last checkpoint before the rewards, the second goes on from there.
Build the program first: cargo build --release.
"""

from __future__ import annotations

import argparse
import json
import shutil
import statistics
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
LABELS_TO_THE_END = {"weight": 1.0, "value_weight": 0.0, "ppo_weight": 0.0, "kl_weight": 0.0}
# The step of `compact` at which its labels begin to make way for rewards.
END_OF_LABELS = 640_000


def features(*names: str) -> list[str]:
    """Returns the arguments that disable the named features."""
    return [arg for name in names for arg in ("--set", f"policy.features.{name}=false")]


# Name -> arguments that change `compact`.
EXPERIMENTS: dict[str, list[str]] = {
    # All checkpoints are kept, for the experiments that begin with one of them.
    "compact": ["--set", "learner.checkpoints.keep=5"],
    "imitator": [],
    "labels-only": [
        arg for key, value in LABELS_TO_THE_END.items() for arg in ("--set", f"learner.imitation.{key}={value}")
    ],
    **{
        name: ["--ablation", name]
        for name in (
            "no-attention",
            "resnet",
            "single-gripper",
            "no-curriculum",
            "no-blueprint-resets",
            "transition-delay",
        )
    },
    "geometry-only": features("plan", "pieces"),
    "paper-inputs": features("plan", "pieces", "up_axis", "membership", "block_shape", "needed_moves"),
    **{f"only-{blueprint}": ["--blueprint", blueprint] for blueprint in ("6_005", "12_000", "16_001")},
}
# Experiments that begin with the last checkpoint of `compact` before the end of its labels.
FROM_LABELS = ("imitator", "labels-only")
# Experiments that are also evaluated without resets, as in the paper.
RESET_FREE = ("compact", "no-blueprint-resets")
GROUPS = ("train 2-6", "train 7-11", "train 12-16", "validation", "test 12-16", "in a row")
TASKS = tuple(name.removeprefix("only-") for name in EXPERIMENTS if name.startswith("only-"))
ACTING = {"greedy": "mode", "sampled": "sampled"}


class InterruptedTraining(Exception):
    """A training ended before its last step."""


def steps_of(folder: Path) -> list[int]:
    """Returns the steps of a run's checkpoints."""
    return [int(path.name.removeprefix("step-")) for path in folder.glob("checkpoints/step-*")]


def train(program: Path, folder: Path, args: list[str]) -> None:
    """Trains a run, with its output in a log file next to the folder.

    An interrupted `train` saves its state and exits with 0, so the steps decide whether the run is complete.

    Raises:
        subprocess.CalledProcessError: the training failed.
        InterruptedTraining: it ended before its last step.
    """
    command = [program, "train", *args, "--no-web"]
    with folder.with_suffix(".log").open("a") as log:
        subprocess.run(command, stdout=log, stderr=log, check=True)
    n_env_steps = tomllib.loads((folder / "config.toml").read_text())["n_env_steps"]
    if max(steps_of(folder), default=0) < n_env_steps:
        raise InterruptedTraining(f"the training in {folder} was interrupted; run the script again")


def fork(source: Path, folder: Path) -> None:
    """Copies the part of a run that a new run needs to go on from the end of its labels."""
    if folder.exists():
        return
    of_labels = [step for step in steps_of(source) if step <= END_OF_LABELS]
    if not of_labels:
        raise SystemExit(f"{source} has kept no checkpoint from before its rewards; remove the run to train it again")
    checkpoint = f"checkpoints/step-{max(of_labels)}"
    part = folder.with_suffix(".part")
    shutil.rmtree(part, ignore_errors=True)
    shutil.copytree(source / checkpoint, part / checkpoint)
    for name in ("config.toml", "meta.json"):
        shutil.copy(source / name, part)
    part.rename(folder)


def complete(program: Path, out: Path, name: str, seed: int, episodes: int) -> None:
    """Trains and evaluates one run, skipping the parts that are done."""
    folder = out / name / f"seed-{seed}"
    report = folder / "report.json"
    if report.exists():
        return
    folder.parent.mkdir(parents=True, exist_ok=True)
    if name in FROM_LABELS:
        complete(program, out, "compact", seed, episodes)
        fork(out / "compact" / f"seed-{seed}", folder)
    trained = folder.with_suffix(".trained")
    if name != "imitator" and not trained.exists():
        begun = (folder / "config.toml").exists()
        of_new = ["--preset", "compact", *EXPERIMENTS[name], "--seed", str(seed), "--run-dir", str(folder)]
        start = ["--resume", str(folder)] if begun else of_new
        if name in FROM_LABELS:
            start += EXPERIMENTS[name]
        print(f"{name}, seed {seed}: training in {folder}", flush=True)
        train(program, folder, start)
        trained.touch()
    print(f"{name}, seed {seed}: evaluating", flush=True)
    evaluate = [program, "eval", "--checkpoint", folder, "--episodes", str(episodes), "--json"]
    if name.startswith("only-"):
        parts = [["--blueprint", name.removeprefix("only-")]]
    else:
        reset_free = ["--reset-free"] if name in RESET_FREE else []
        parts = [["--split", "train", *reset_free], ["--split", "validation"], ["--split", "test"]]
    told = [subprocess.run([*evaluate, *part], stdout=subprocess.PIPE, check=True).stdout for part in parts]
    part = report.with_suffix(".part")
    part.write_text(json.dumps([json.loads(one) for one in told]))
    part.rename(report)


def rates(reports: list[dict[str, Any]], mode: str) -> dict[str, float]:
    """Returns the success rates by group, of the blueprints with their own experiment, and without resets."""
    found: dict[str, float] = {}
    for report in reports:
        found |= {group["name"]: group[mode]["success"]["rate"] for group in report["summary"]["groups"]}
        found |= {
            one["blueprint"]: one[mode]["success"]["rate"]
            for one in report["blueprints"]
            if f"only-{one['blueprint']}" in EXPERIMENTS
        }
        if reset_free := report["summary"].get("reset_free"):
            found["in a row"] = reset_free[mode]["outcome"]["success"]["rate"]
    return found


def cell(found: list[float]) -> str:
    """Formats the mean in percent, with the extremes if they differ."""
    if not found:
        return "–"
    mean, least, most = (f"{100 * value:.1f}" for value in (statistics.mean(found), min(found), max(found)))
    return f"{mean}%" if least == most else f"{mean}% ({least}–{most})"


def table(out: Path, names: list[str], columns: tuple[str, ...]) -> str:
    """Returns a Markdown table with a row per experiment and greedy or sampled actions, where any column has data."""
    lines = ["| experiment | seeds | actions | " + " | ".join(columns) + " |", "|---|---|---|" + "---|" * len(columns)]
    for name in names:
        reports = [json.loads(path.read_text()) for path in sorted(out.glob(f"{name}/seed-*/report.json"))]
        for acting, mode in ACTING.items():
            found = [rates(report, mode) for report in reports]
            if any(column in one for one in found for column in columns):
                cells = [cell([one[column] for one in found if column in one]) for column in columns]
                lines.append(f"| {name} | {len(reports)} | {acting} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> int:
    """Runs the requested experiments. Returns the number of runs that failed or were interrupted as the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder of the runs")
    parser.add_argument("names", nargs="*", help=f"experiments [default: all]: {', '.join(EXPERIMENTS)}")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--episodes", type=int, default=10, help="per blueprint, at the end")
    parser.add_argument("--table", action="store_true", help="train nothing")
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/lodestone")
    args = parser.parse_intermixed_args()
    names = args.names or list(EXPERIMENTS)
    if unknown := [name for name in names if name not in EXPERIMENTS]:
        parser.error(f"no experiment {unknown[0]!r}")
    n_failed = 0
    for seed in [] if args.table else args.seeds:
        for name in names:
            try:
                complete(args.program, args.out, name, seed, args.episodes)
            except subprocess.CalledProcessError as error:
                print(f"{name}, seed {seed}: failed with {error.returncode}; see its log", file=sys.stderr)
                n_failed += 1
            except InterruptedTraining as error:
                print(f"{name}, seed {seed}: {error}", file=sys.stderr)
                n_failed += 1
    multi_task = [name for name in names if name == "compact" or name.startswith("only-")]
    print(table(args.out, [name for name in names if not name.startswith("only-")], GROUPS))
    print("", table(args.out, multi_task, TASKS), sep="\n")
    return n_failed


if __name__ == "__main__":
    sys.exit(main())

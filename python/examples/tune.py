#!/usr/bin/env python3
"""Searches settings of the training with Optuna: each trial is a `lodestone sweep` of one point with several seeds.

    pip install optuna
    python python/examples/tune.py --steps 2e5 --seeds 2 --trials 20 --out sweeps/tuned

The objective is the mean success over seeds, goals, and groups of sizes, as `sweep --json` prints it. Optuna keeps the
trials in OUT/study.db, so the same command goes on with them: `--trials` more each time. `optuna-dashboard` shows them.
"""

from __future__ import annotations

import argparse
import json
import subprocess
from pathlib import Path

import optuna


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default="lodestone")
    parser.add_argument("--steps", default="2e5", help="environment steps of each run")
    parser.add_argument("--seeds", type=int, default=2, help="runs of each trial")
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a setting of all trials")
    parser.add_argument("--out", type=Path, required=True)
    return parser.parse_args()


def objective(trial: optuna.Trial, args: argparse.Namespace) -> float:
    """Trains with settings that Optuna suggests; returns the mean success."""
    suggested = {
        "learner.optimizer.learning_rate": trial.suggest_float("learning_rate", 1e-4, 3e-3, log=True),
        "learner.gamma": trial.suggest_float("gamma", 0.9, 0.99),
    }
    command = [args.program, "sweep", "--json", "--out", str(args.out / f"trial-{trial.number}")]
    command += ["--steps", args.steps, "--seeds", str(args.seeds)]
    for key, value in suggested.items():
        command += ["--grid", f"{key}={value}"]
    for setting in args.set:
        command += ["--set", setting]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode != 0:
        # The program has said why. Another point may do better.
        raise optuna.TrialPruned(f"{command[0]} ended with {done.returncode}")
    groups = json.loads(done.stdout)["points"][0]["groups"]
    return sum(group["mean"] for group in groups) / len(groups)


def main() -> None:
    args = arguments()
    args.out.mkdir(parents=True, exist_ok=True)
    storage = f"sqlite:///{args.out / 'study.db'}"
    study = optuna.create_study(study_name="lodestone", storage=storage, direction="maximize", load_if_exists=True)
    study.optimize(lambda trial: objective(trial, args), n_trials=args.trials)
    print(f"best of {len(study.trials)} trials: {study.best_value:.1%} with {study.best_params}")


if __name__ == "__main__":
    main()

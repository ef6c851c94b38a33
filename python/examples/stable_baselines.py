#!/usr/bin/env python3
"""Learns with MaskablePPO of sb3-contrib which of the proposed moves to make.

    pip install "./python[sb3]"
    python python/examples/stable_baselines.py --steps 100000 --out policy.zip
"""

from __future__ import annotations

import argparse

import lodestone
import numpy as np
from lodestone.sb3 import AssemblyVecEnv
from sb3_contrib import MaskablePPO
from stable_baselines3.common.vec_env import VecMonitor


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--blueprint", help="id, split, or path of a TOML file; all training goals of two blocks")
    parser.add_argument("--steps", type=int, default=100_000, help="steps of all worlds")
    parser.add_argument("--worlds", type=int, default=32)
    parser.add_argument("--rollout", type=int, default=128, help="steps of each world between two updates")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", help="where to save the policy")
    args = parser.parse_args()
    goals = args.blueprint or [name for name, size in lodestone.blueprints("train").items() if size == 2]
    world = {"blueprint": goals, "action": "proposals", "mask": "blueprint"}
    envs = VecMonitor(AssemblyVecEnv(args.worlds, **world))
    model = MaskablePPO("MlpPolicy", envs, n_steps=args.rollout, gamma=0.95, seed=args.seed, verbose=1)
    model.learn(args.steps)
    if args.out:
        model.save(args.out)

    trials = AssemblyVecEnv(64, **world)
    trials.seed(args.seed + 1000)
    seen, built, ended = trials.reset(), np.zeros(64, np.bool_), np.zeros(64, np.bool_)
    while not ended.all():
        picks, _ = model.predict(seen, action_masks=np.stack(trials.env_method("action_masks")))
        seen, _, dones, infos = trials.step(picks)
        built |= dones & ~ended & [info["is_success"] for info in infos]
        ended |= dones
    print(f"builds {built.mean():.0%} of {len(built)} trials")


if __name__ == "__main__":
    main()

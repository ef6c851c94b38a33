#!/usr/bin/env python3
"""Compares the speed of worlds in Python with the same loops in Rust and with MuJoCo, and prints a Markdown table.

    python python/benches/speed.py
    python python/benches/speed.py --at-least 0.8        # fails if Python has less than 80% of Rust's rate in some row

Rates are world steps per CPU-second on one thread, the best of three rounds. Linux only. The Rust side is
`benches/rollout.rs`. MuJoCo, if installed, steps the same 16 blocks in a Python loop, without magnets, features, or
rewards.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import lodestone
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
ID = "Lodestone/Assembly-v0"
N_WORLDS, N_STEPS, N_ROUNDS = 32, 100, 3


def vector(act: str, **world: Any) -> Callable[[int], float]:
    """Returns a function that measures the steps per CPU-second of a batch with policy or random actions."""
    envs = gymnasium.make_vec(ID, num_envs=N_WORLDS, num_threads=1, **world)
    policy = lodestone.Policy.pretrained()
    envs.action_space.seed(0)
    drawn = [envs.action_space.sample() for _ in range(16)]

    def rate(seed: int) -> float:
        envs.reset(seed=1000 * seed)
        before, n_steps = time.process_time(), 0
        for step in range(N_STEPS):
            infos = envs.step(policy.act(envs) if act == "policy" else drawn[step % 16])[4]
            # A world that starts an episode does not step.
            n_steps += N_WORLDS - infos.get("_blueprint", np.zeros(1)).sum()
        return n_steps / (time.process_time() - before)

    return rate


def single(**world: Any) -> Callable[[int], float]:
    """Returns a function that measures the steps per CPU-second of one environment with random actions."""
    env = gymnasium.make(ID, disable_env_checker=True, **world)
    env.action_space.seed(0)
    drawn = [env.action_space.sample() for _ in range(16)]

    def rate(seed: int) -> float:
        env.reset(seed=seed)
        before = time.process_time()
        for step in range(1000):
            _, _, terminated, truncated, _ = env.step(drawn[step % 16])
            if terminated or truncated:
                env.reset()
        return 1000 / (time.process_time() - before)

    return rate


def best(rate: Callable[[int], float]) -> float:
    return max(rate(seed) for seed in range(N_ROUNDS))


def in_rust() -> dict[str, float]:
    """Runs the Rust benchmark and returns its rates by name."""
    command = ["cargo", "bench", "--locked", "--bench", "rollout", "--manifest-path", str(ROOT / "python/Cargo.toml")]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def mujoco() -> float | None:
    """Returns MuJoCo's control steps per CPU-second in a Python loop, or None if it is not installed."""
    if importlib.util.find_spec("mujoco") is None:
        print("not run: MuJoCo, as this Python has no module mujoco", file=sys.stderr)
        return None
    spec = importlib.util.spec_from_file_location("mujoco_peer", ROOT / "lab/benches/mujoco_peer.py")
    peer = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(peer)
    return max(peer.rate("random") for _ in range(N_ROUNDS))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--at-least", type=float, metavar="RATIO", help="fail if a row's ratio to Rust is lower")
    args = parser.parse_args()
    rust, peer = in_rust(), mujoco()
    rows = [
        ("32 worlds, the policy acts", best(vector("policy")), rust["policy"]),
        ("32 worlds, random actions", best(vector("random")), rust["random"]),
        ("32 worlds, random actions, `copy=False`", best(vector("random", copy=False)), rust["random"]),
        ("32 worlds, random actions, flat", best(vector("random", observation="flat", action="flat")), rust["random"]),
        ("one world, random actions", best(single()), rust["random"]),
    ]
    print("| steps per CPU-second | Python | Rust | ratio |" + (" MuJoCo in Python | ratio |" if peer else ""))
    print("|---|---|---|---|" + ("---|---|" if peer else ""))
    for name, ours, theirs in rows:
        line = f"| {name} | {ours:,.0f} | {theirs:,.0f} | {ours / theirs:.2f} |"
        if peer:
            line += f" {peer:,.0f} | {ours / peer:.2f} |" if "random" in name else " – | – |"
        print(line)
    name, ratio = min(((name, ours / theirs) for name, ours, theirs in rows), key=lambda row: row[1])
    if args.at_least is not None and ratio < args.at_least:
        sys.exit(f"{name}: {ratio:.3f} of the rate in Rust, less than {args.at_least}")


if __name__ == "__main__":
    main()

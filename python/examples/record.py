#!/usr/bin/env python3
"""Records episodes of the expert or the pretrained policy as a Minari dataset for offline learning.

    pip install ./python "minari[create,hdf5]" pillow
    python python/examples/record.py --blueprint 4_000 --episodes 20
    python -c 'import minari; print(minari.load_dataset("lodestone/4_000/expert-v0"))'

Minari stores datasets in ~/.minari, or in MINARI_DATASETS_PATH if set.
"""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import gymnasium
import lodestone
from minari import DataCollector


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--blueprint", default="4_000", help="id, split, or path of a TOML file")
    parser.add_argument("--starts", default="scattered", help="scattered, prebuilt, near-goal:N, ...")
    parser.add_argument("--agent", choices=["expert", "policy"], default="expert")
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--name", help="name of the dataset; lodestone/BLUEPRINT/AGENT-v0 by default")
    args = parser.parse_args()
    # Minari allows neither dots nor further slashes in a name.
    goal = re.sub(r"[^A-Za-z0-9_-]", "-", Path(args.blueprint).stem)
    agent = lodestone.Expert() if args.agent == "expert" else lodestone.Policy.pretrained()
    env = DataCollector(gymnasium.make("Lodestone/Assembly-v0", blueprint=args.blueprint, starts=args.starts))
    n_built = 0
    for episode in range(args.episodes):
        env.reset(seed=args.seed + episode)
        done = False
        while not done:
            _, _, terminated, truncated, _ = env.step(agent.act(env))
            done = terminated or truncated
        n_built += terminated
    dataset = env.create_dataset(
        dataset_id=args.name or f"lodestone/{goal}/{args.agent}-v0",
        algorithm_name=args.agent,
        description=f"The {args.agent} assembles {args.blueprint} from {args.starts} starts.",
    )
    env.close()
    print(f"{dataset.spec.dataset_id}: {dataset.total_episodes} episodes, {dataset.total_steps} steps, {n_built} built")


if __name__ == "__main__":
    main()

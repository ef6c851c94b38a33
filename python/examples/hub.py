#!/usr/bin/env python3
"""Prepares folders for a hub such as Hugging Face: a policy with its model card, or a dataset with its card.

    pip install ./python
    python python/examples/hub.py model OUT                                   # the shipped policy
    python python/examples/hub.py model OUT --policy policy.safetensors       # one of lodestone export
    python python/examples/hub.py dataset OUT --name lodestone/expert-v0      # one of python -m lodestone.record

It uploads nothing; `huggingface-cli upload NAME OUT` does. A model card states what the policy's own episodes show: it
plays EPISODES of each goal of a split from scattered starts.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import lodestone
import numpy as np

ROOT = Path(__file__).parents[2]
SHIPPED = ROOT / "deploy/pretrained"
USE = """
```python
import gymnasium, lodestone

env = gymnasium.make("Lodestone/Assembly-v0", blueprint="4_000")
policy = lodestone.Policy.load("policy.safetensors")
env.reset(seed=1)
env.step(policy.act(env))
```
"""


def card(head: dict[str, Any], title: str, body: str) -> str:
    """Returns a page with the entries that a hub reads. JSON is YAML, too."""
    entries = "\n".join(f"{key}: {json.dumps(value)}" for key, value in head.items())
    return f"---\n{entries}\n---\n\n# {title}\n\n{body.strip()}\n"


def success(policy: lodestone.Policy, goals: str, episodes: int) -> tuple[float, int]:
    """Returns the share of episodes in which the policy, acting greedily, builds the goal, and their number."""
    built = []
    for seed, goal in enumerate(lodestone.blueprints(goals)):
        settings = {"n_grippers": policy.native.n_grippers}
        envs = lodestone.AssemblyVectorEnv(episodes, autoreset_mode="SameStep", blueprint=goal, settings=settings)
        envs.reset(seed=1000 * seed)
        is_built, running = np.zeros(episodes, np.bool_), np.ones(episodes, np.bool_)
        while running.any():
            _, _, terminated, truncated, _ = envs.step(policy.act(envs))
            is_built |= running & terminated
            running &= ~(terminated | truncated)
        built += is_built.tolist()
    return float(np.mean(built)), len(built)


def model(args: argparse.Namespace) -> None:
    path = args.policy or SHIPPED / "model.safetensors"
    policy = lodestone.Policy.load(path)
    rate, n = success(policy, args.split, args.episodes)
    metric = {"type": "success_rate", "value": round(rate, 4), "name": f"greedy, {n} episodes"}
    task = {"type": "reinforcement-learning", "name": "reinforcement-learning"}
    dataset = {"type": "Lodestone/Assembly-v0", "name": f"Lodestone/Assembly-v0, {args.split} goals"}
    head = {
        "license": "mit",
        "library_name": "lodestone",
        "pipeline_tag": "reinforcement-learning",
        "tags": ["reinforcement-learning", "robotics", "graph-neural-network", "Lodestone/Assembly-v0"],
        "model-index": [
            {"name": path.stem, "results": [{"task": task, "dataset": dataset, "metrics": [metric]}]},
        ],
    }
    body = f"""Two grippers assemble magnet blocks into blueprints. Acting greedily from scattered starts, this policy builds
the goals of the split `{args.split}` in {rate:.1%} of {n} episodes. It has version {policy.version} of its weights.
{USE}"""
    if not args.policy:
        # Its links lead to files that the hub does not have.
        about = re.sub(r"\[([^]]+)\]\([^)]*\)", r"\1", (SHIPPED / "README.md").read_text())
        body += about.split("\n", 1)[1]
    shutil.copyfile(path, args.out / "policy.safetensors")
    (args.out / "README.md").write_text(card(head, "A policy that assembles magnet blocks", body))


def dataset(args: argparse.Namespace) -> None:
    import minari

    found = minari.load_dataset(args.name)
    told = found.storage.get_episode_metadata(found.episode_indices)
    n_built = sum(bool(episode["is_success"]) for episode in told)
    head = {
        "license": "mit",
        "task_categories": ["reinforcement-learning", "robotics"],
        "tags": ["minari", "offline-rl", "Lodestone/Assembly-v0"],
    }
    body = f"""{found.total_episodes} episodes and {found.total_steps} steps, of which {n_built} episodes end with the
goal built. Recorded with `python -m lodestone.record`, so a reset with an episode's `seed` and `options` and its
actions lead to its observations, bit for bit.

```python
import minari

dataset = minari.load_dataset({args.name!r})
env = dataset.recover_environment()
```
"""
    target = args.out / "datasets" / args.name
    shutil.copytree(found.storage.data_path.parent, target)
    (args.out / "README.md").write_text(card(head, args.name, body))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("model", "dataset"))
    parser.add_argument("out", type=Path, metavar="OUT", help="folder, which must not exist")
    parser.add_argument("--policy", type=Path, help="file of lodestone export; the shipped policy by default")
    parser.add_argument("--split", default="validation", help="goals that the policy plays for its card")
    parser.add_argument("--episodes", type=int, default=10, help="episodes of each goal")
    parser.add_argument("--name", default="lodestone/expert-v0", help="name of the Minari dataset")
    args = parser.parse_args()
    if args.out.exists():
        sys.exit(f"{args.out} exists: choose another folder")
    args.out.mkdir(parents=True)
    {"model": model, "dataset": dataset}[args.what](args)
    print(f"{args.out}: {', '.join(sorted(str(path.relative_to(args.out)) for path in args.out.rglob('*.*')))}")


if __name__ == "__main__":
    main()

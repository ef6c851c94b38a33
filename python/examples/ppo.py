#!/usr/bin/env python3
"""Single-file proximal policy optimization for Lodestone's worlds, after CleanRL, with discrete actions.

    pip install ./python torch
    python python/examples/ppo.py                                   # training goals of two blocks; two minutes
    python python/examples/ppo.py --blueprint train --mask blueprint --steps 10000000

Each gripper picks one of the moves that the scene proposes (`lodestone.proposals`), such as joining block 3 to block 7.
A plain Gaussian would have to hit these moves by chance. The first gripper picks among what is offered, and the second
one, which knows the first one's pick, among what is offered of the other blocks. The network is small and treats every
block alike: it embeds each block from its features and the sum over its edges within the blueprint, and computes the
logit of a pick from the two blocks and the edge that it is about.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import deque
from pathlib import Path
from typing import Any

import gymnasium
import lodestone
import numpy as np
import torch
from torch import Tensor, nn
from torch.distributions import Categorical


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--blueprint", help="id, split, or path of a TOML file; all training goals of two blocks")
    parser.add_argument("--starts", default="scattered", help="scattered, prebuilt, near-goal:N, ...")
    parser.add_argument("--mask", default="none", help="blueprint: only its blocks, and connected ones, are offered")
    parser.add_argument("--steps", type=int, default=40_000, help="steps of all worlds")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--worlds", type=int, default=32)
    parser.add_argument("--rollout", type=int, default=32, help="steps of each world between two updates")
    parser.add_argument("--epochs", type=int, default=4)
    parser.add_argument("--minibatches", type=int, default=4)
    parser.add_argument("--rate", type=float, default=1e-3, help="learning rate of Adam")
    parser.add_argument("--gamma", type=float, default=0.95)
    parser.add_argument("--gae-lambda", type=float, default=0.9)
    parser.add_argument("--clip", type=float, default=0.2)
    parser.add_argument("--entropy", type=float, default=0.003)
    parser.add_argument("--width", type=int, default=64)
    parser.add_argument("--trials", type=int, default=64, help="episodes that are played before and after")
    parser.add_argument("--metrics", type=Path, help="write a line of JSON here after each update, for lab/learning.py")
    return parser.parse_args()


# Indices of the features used as flags: a block belongs to the blueprint, and both blocks of an edge do.
MEMBER, BOTH_MEMBERS = 6, 23


class Agent(nn.Module):
    """Policy and value network for a batch of scenes."""

    def __init__(self, envs: Any, width: int) -> None:
        super().__init__()
        space, about = envs.single_observation_space, lodestone.proposals(envs)
        nd, ed, gd = (space[name].shape[-1] for name in ("nodes", "edges", "globals"))
        self.n_grippers = len(envs.single_action_space.nvec)
        # A pick is block · n_slots + slot.
        kinds, partners = (torch.from_numpy(about[name]) for name in ("kinds", "partners"))
        self.n_slots, self.n_kinds = len(kinds), len(kinds.unique())
        self.register_buffer("kinds", nn.functional.one_hot(kinds, self.n_kinds).float())
        self.register_buffer("partners", partners)
        # Edges are in sender-major order, without self-edges.
        receivers = [i for j in range(16) for i in range(16) if i != j]
        self.register_buffer("gather", nn.functional.one_hot(torch.tensor(receivers), 16).T.float())

        def mlp(n_in: int, n_out: int) -> nn.Sequential:
            return nn.Sequential(nn.Linear(n_in, width), nn.ReLU(), nn.Linear(width, n_out))

        self.edge = nn.Sequential(nn.Linear(ed, width), nn.ReLU())
        self.node = nn.Sequential(mlp(nd + width + gd, width), nn.ReLU())
        # The two blocks, their edge, the kind, the gripper, and how the pick touches the first gripper's.
        self.pick = mlp(2 * width + ed + self.n_kinds + self.n_grippers + 3 + self.n_kinds, 1)
        self.value = mlp(width, 1)
        nn.init.zeros_(self.pick[-1].weight)

    def blocks(self, seen: dict[str, Tensor]) -> Tensor:
        """Returns an embedding of each block [n, 16, width]."""
        edges = self.gather @ (self.edge(seen["edges"]) * seen["edges"][..., BOTH_MEMBERS, None])
        globals_ = seen["globals"][:, None].expand(-1, 16, -1)
        return self.node(torch.cat([seen["nodes"], edges, globals_], dim=-1))

    def values(self, seen: dict[str, Tensor], blocks: Tensor | None = None) -> Tensor:
        """Returns expected returns [n]."""
        blocks = self.blocks(seen) if blocks is None else blocks
        members = seen["nodes"][..., MEMBER, None]
        return self.value((blocks * members).sum(dim=1) / members.sum(dim=1)).squeeze(-1)

    def choices(self, seen: dict[str, Tensor], blocks: Tensor, offered: Tensor, before: list[Tensor]) -> Categorical:
        """Returns the distribution of a gripper's picks, after the picks [n] of those before it.

        Computes the logits only of what is `offered` [n, picks]: a goal of two blocks offers 18 of 528.
        """
        rows, picks = offered.nonzero(as_tuple=True)
        block, partner, kinds = self.about(picks)
        has_partner = (partner >= 0).float()[:, None]
        partner = partner.clamp(min=0)
        # The pick's block receives the edge. The edge of a block to itself is any; it is multiplied by 0.
        edge = (partner * 15 + block - (block > partner).long()).clamp(max=239)
        gripper = torch.zeros(len(rows), self.n_grippers)
        gripper[:, len(before)] = 1.0
        touches = torch.zeros(len(rows), 3 + self.n_kinds)
        for first in before:
            first_block, first_partner, first_kinds = (x[rows] for x in self.about(first))
            is_toward, is_met = (partner == first_block) & (has_partner[:, 0] > 0), block == first_partner
            touches = torch.cat([torch.stack([is_toward, is_met, is_toward & is_met], dim=1), first_kinds], dim=1)
        x = [blocks[rows, block], blocks[rows, partner] * has_partner, seen["edges"][rows, edge] * has_partner]
        logits = self.pick(torch.cat([*x, kinds, gripper, touches], dim=1)).squeeze(1)
        return Categorical(logits=torch.full(offered.shape, -1e9).index_put((rows, picks), logits))

    def about(self, picks: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Returns the blocks of picks [k], their partners, -1 for none, and their kinds [k, 3]."""
        slots = picks % self.n_slots
        return picks // self.n_slots, self.partners[slots], self.kinds[slots]

    def act(
        self, seen: dict[str, Tensor], offered: Tensor, picks: Tensor | None = None
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Returns picks [n, grippers], log-probabilities, entropies, and values. Samples picks if they are None."""
        blocks = self.blocks(seen)
        log_probs, entropies = torch.zeros(len(offered)), torch.zeros(len(offered))
        before: list[Tensor] = []
        for gripper in range(self.n_grippers):
            choices = self.choices(seen, blocks, offered, before)
            chosen = choices.sample() if picks is None else picks[:, gripper]
            log_probs, entropies = log_probs + choices.log_prob(chosen), entropies + choices.entropy()
            before.append(chosen)
            # Two grippers on one block can do no more than one.
            taken = torch.arange(16 * self.n_slots) // self.n_slots == (chosen // self.n_slots)[:, None]
            offered = offered & ~taken
        return torch.stack(before, dim=1), log_probs, entropies, self.values(seen, blocks)


def tensors(seen: dict[str, np.ndarray]) -> dict[str, Tensor]:
    """Converts arrays to tensors that share their memory."""
    return {name: torch.from_numpy(x) for name, x in seen.items()}


def offers(envs: Any) -> Tensor:
    """Returns what each world offers to any gripper [n, 528]."""
    masks = envs.unwrapped.action_masks()
    return torch.from_numpy(masks[:, : masks.shape[1] // len(envs.single_action_space.nvec)])


def make(args: argparse.Namespace, n: int) -> Any:
    goals = args.blueprint or [name for name, size in lodestone.blueprints("train").items() if size == 2]
    return gymnasium.make_vec(
        "Lodestone/Assembly-v0",
        num_envs=n,
        autoreset_mode="SameStep",
        blueprint=goals,
        starts=args.starts,
        action="proposals",
        mask=args.mask,
    )


def success(agent: Agent, args: argparse.Namespace) -> str:
    """Plays an episode in each of a few worlds with sampled picks; returns the share that is built."""
    envs = make(args, args.trials)
    seen = envs.reset(seed=args.seed + 1000)[0]
    built, running = np.zeros(args.trials, np.bool_), np.ones(args.trials, np.bool_)
    while running.any():
        with torch.no_grad():
            picks = agent.act(tensors(seen), offers(envs))[0]
        seen, _, terminated, truncated, _ = envs.step(picks.numpy())
        built |= running & terminated
        running &= ~(terminated | truncated)
    return f"builds {built.mean():.0%} of {args.trials} trials"


def main() -> None:
    args = arguments()
    torch.manual_seed(args.seed)
    envs = make(args, args.worlds)
    seen, offered = tensors(envs.reset(seed=args.seed)[0]), offers(envs)
    agent = Agent(envs, args.width)
    optimizer = torch.optim.Adam(agent.parameters(), lr=args.rate, eps=1e-5)
    print("untrained,", success(agent, args), flush=True)
    finished: deque[bool] = deque(maxlen=200)
    metrics = args.metrics.open("w", buffering=1) if args.metrics else None
    n_updates, began = args.steps // (args.worlds * args.rollout), time.monotonic()
    for update in range(1, n_updates + 1):
        optimizer.param_groups[0]["lr"] = args.rate * (1 - (update - 1) / n_updates)
        kept: list[tuple[dict[str, Tensor], Tensor, Tensor, Tensor, Tensor]] = []
        rewards, ends = torch.zeros(args.rollout, args.worlds), torch.zeros(args.rollout, args.worlds)
        n_built = n_ended = 0
        for step in range(args.rollout):
            with torch.no_grad():
                picks, log_probs, _, values = agent.act(seen, offered)
            kept.append((seen, offered, picks, log_probs, values))
            after, reward, terminated, truncated, infos = envs.step(picks.numpy())
            rewards[step] = torch.from_numpy(reward)
            ends[step] = torch.from_numpy(terminated | truncated)
            if truncated.any():
                # A time limit does not end the return: bootstrap from the critic's value of the final observation.
                last = [infos["final_obs"][row] for row in np.flatnonzero(truncated)]
                stacked = {name: np.stack([one[name] for one in last]) for name in last[0]}
                with torch.no_grad():
                    rewards[step, torch.from_numpy(truncated)] += args.gamma * agent.values(tensors(stacked))
            finished.extend(terminated[terminated | truncated].tolist())
            n_built, n_ended = n_built + int(terminated.sum()), n_ended + int((terminated | truncated).sum())
            seen, offered = tensors(after), offers(envs)
        with torch.no_grad():
            next_value = agent.values(seen)
        values = torch.stack([one[4] for one in kept])
        advantages, running = torch.zeros_like(rewards), torch.zeros(args.worlds)
        for step in reversed(range(args.rollout)):
            goes_on = 1.0 - ends[step]
            error = rewards[step] + args.gamma * next_value * goes_on - values[step]
            running = error + args.gamma * args.gae_lambda * goes_on * running
            advantages[step], next_value = running, values[step]
        targets = (advantages + values).flatten()
        advantages = advantages.flatten()
        scenes = {name: torch.cat([one[0][name] for one in kept]) for name in seen}
        masks, picks, log_probs = (torch.cat([one[k] for one in kept]) for k in (1, 2, 3))
        for _ in range(args.epochs):
            for rows in torch.randperm(len(targets)).chunk(args.minibatches):
                minibatch = {name: x[rows] for name, x in scenes.items()}
                _, new_log_probs, entropies, new_values = agent.act(minibatch, masks[rows], picks[rows])
                ratio = (new_log_probs - log_probs[rows]).exp()
                advantage = advantages[rows]
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                clipped = ratio.clamp(1 - args.clip, 1 + args.clip)
                policy_loss = -torch.min(ratio * advantage, clipped * advantage).mean()
                value_loss = 0.5 * (new_values - targets[rows]).square().mean()
                loss = policy_loss + 0.5 * value_loss - args.entropy * entropies.mean()
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimizer.step()
        n_steps, elapsed_s = update * args.worlds * args.rollout, time.monotonic() - began
        if metrics:
            # With the names of Lodestone's own metrics.jsonl.
            episodes = {"success": {"n_successes": n_built, "n_episodes": n_ended}}
            line = {"key": "learner", "n_env_steps": n_steps, "elapsed_s": elapsed_s, "episodes": episodes}
            metrics.write(json.dumps(line) + "\n")
        if update % 5 == 0 or update == n_updates:
            share = f"{np.mean(finished):.0%}" if finished else "–"
            rate = n_steps / elapsed_s
            print(
                f"{n_steps:>9,} steps  success {share:>4} of the last {len(finished)}  {rate:,.0f} steps/s", flush=True
            )
    print("trained,", success(agent, args), flush=True)


if __name__ == "__main__":
    main()

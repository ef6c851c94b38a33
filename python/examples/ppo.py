#!/usr/bin/env python3
"""Single-file proximal policy optimization for Lodestone's worlds, after CleanRL.

    pip install ./python torch
    python python/examples/ppo.py                                   # two blocks, starts near the goal; ten minutes
    python python/examples/ppo.py --blueprint train --starts scattered --steps 10000000

The network is small and treats every block alike. It embeds each block from its features and the sum over its edges
within the blueprint, then computes the logits of the grippers' choices and the means of the moves. Grippers choose
among the blueprint's blocks. The log-probability of an action covers the choices and the moves of the chosen blocks,
each counted once, as in the paper.
"""

from __future__ import annotations

import argparse
import time
from collections import deque

import gymnasium
import lodestone  # noqa: F401, registers the environment
import numpy as np
import torch
from torch import Tensor, nn
from torch.distributions import Categorical, Normal


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--blueprint", default="2_000", help="id, split, or path of a TOML file")
    parser.add_argument("--starts", default="near-goal:1", help="scattered, prebuilt, near-goal:N, ...")
    parser.add_argument("--steps", type=int, default=300_000, help="steps of all worlds")
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
    return parser.parse_args()


# Indices of the features used as flags: a block belongs to the blueprint, and both blocks of an edge do.
MEMBER, BOTH_MEMBERS = 6, 23


class Agent(nn.Module):
    """Policy and value network for a batch of scenes."""

    def __init__(self, space: gymnasium.spaces.Dict, n_grippers: int, width: int) -> None:
        super().__init__()
        nd, ed, gd = (space[name].shape[-1] for name in ("nodes", "edges", "globals"))
        self.edge = nn.Sequential(nn.Linear(ed, width), nn.ReLU())
        self.node = nn.Sequential(nn.Linear(nd + width + gd, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        self.choices = nn.Linear(width, n_grippers)
        self.moves = nn.Linear(width, 6)
        self.value = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 1))
        self.log_std = nn.Parameter(torch.full((6,), -0.7))
        # Edges are in sender-major order, without self-edges.
        receivers = [i for j in range(16) for i in range(16) if i != j]
        self.register_buffer("gather", nn.functional.one_hot(torch.tensor(receivers), 16).T.float())
        for head in (self.choices, self.moves):
            nn.init.orthogonal_(head.weight, 0.01)
            nn.init.zeros_(head.bias)

    def forward(self, seen: dict[str, Tensor]) -> tuple[Categorical, Normal, Tensor]:
        """Returns the distributions of choices [n, grippers] and moves [n, 16, 6], and the values [n]."""
        edges = self.gather @ (self.edge(seen["edges"]) * seen["edges"][..., BOTH_MEMBERS, None])
        globals_ = seen["globals"][:, None].expand(-1, 16, -1)
        blocks = self.node(torch.cat([seen["nodes"], edges, globals_], dim=-1))
        logits = self.choices(blocks).masked_fill(seen["nodes"][..., MEMBER, None] == 0, -1e9)
        choices = Categorical(logits=logits.transpose(1, 2))
        moves = Normal(self.moves(blocks), self.log_std.exp())
        return choices, moves, self.value(blocks.mean(dim=1)).squeeze(-1)

    def act(
        self, seen: dict[str, Tensor], choices: Tensor | None = None, moves: Tensor | None = None
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Returns choices, moves, log-probabilities, entropies, and values. Samples choices or moves that are None."""
        of_choices, of_moves, values = self(seen)
        choices = of_choices.sample() if choices is None else choices
        moves = of_moves.sample() if moves is None else moves
        chosen = nn.functional.one_hot(choices, 16).amax(dim=1).float()
        log_probs = of_choices.log_prob(choices).sum(dim=-1)
        log_probs = log_probs + (of_moves.log_prob(moves).sum(dim=-1) * chosen).sum(dim=-1)
        entropies = of_choices.entropy().sum(dim=-1) + (of_moves.entropy().sum(dim=-1) * chosen).sum(dim=-1)
        return choices, moves, log_probs, entropies, values


def tensors(seen: dict[str, np.ndarray]) -> dict[str, Tensor]:
    """Converts arrays to tensors that share their memory."""
    return {name: torch.from_numpy(x) for name, x in seen.items()}


def main() -> None:
    args = arguments()
    torch.manual_seed(args.seed)
    envs = gymnasium.make_vec(
        "Lodestone/Assembly-v0",
        num_envs=args.worlds,
        autoreset_mode="SameStep",
        blueprint=args.blueprint,
        starts=args.starts,
    )
    n_grippers = envs.single_action_space["choices"].shape[0]
    agent = Agent(envs.single_observation_space, n_grippers, args.width)
    optimizer = torch.optim.Adam(agent.parameters(), lr=args.rate, eps=1e-5)
    seen = tensors(envs.reset(seed=args.seed)[0])
    finished: deque[bool] = deque(maxlen=200)
    n_updates, began = args.steps // (args.worlds * args.rollout), time.monotonic()
    for update in range(1, n_updates + 1):
        optimizer.param_groups[0]["lr"] = args.rate * (1 - (update - 1) / n_updates)
        kept: list[tuple[dict[str, Tensor], Tensor, Tensor, Tensor, Tensor]] = []
        rewards, ends = torch.zeros(args.rollout, args.worlds), torch.zeros(args.rollout, args.worlds)
        for step in range(args.rollout):
            with torch.no_grad():
                choices, moves, log_probs, _, values = agent.act(seen)
            kept.append((seen, choices, moves, log_probs, values))
            action = {"choices": choices.numpy(), "moves": moves.numpy()}
            after, reward, terminated, truncated, infos = envs.step(action)
            rewards[step] = torch.from_numpy(reward)
            ends[step] = torch.from_numpy(terminated | truncated)
            if truncated.any():
                # A time limit does not end the return: bootstrap from the critic's value of the final observation.
                last = [infos["final_obs"][row] for row in np.flatnonzero(truncated)]
                stacked = {name: np.stack([one[name] for one in last]) for name in last[0]}
                with torch.no_grad():
                    rewards[step, torch.from_numpy(truncated)] += args.gamma * agent(tensors(stacked))[2]
            finished.extend(terminated[terminated | truncated].tolist())
            seen = tensors(after)
        with torch.no_grad():
            next_value = agent(seen)[2]
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
        choices, moves, log_probs = (torch.cat([one[k] for one in kept]) for k in (1, 2, 3))
        for _ in range(args.epochs):
            for rows in torch.randperm(len(targets)).chunk(args.minibatches):
                minibatch = {name: x[rows] for name, x in scenes.items()}
                _, _, new_log_probs, entropies, new_values = agent.act(minibatch, choices[rows], moves[rows])
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
        if update % 5 == 0 or update == n_updates:
            n_steps = update * args.worlds * args.rollout
            share = f"{np.mean(finished):.0%}" if finished else "–"
            rate = n_steps / (time.monotonic() - began)
            print(
                f"{n_steps:>9,} steps  success {share:>4} of the last {len(finished)}  {rate:,.0f} steps/s", flush=True
            )


if __name__ == "__main__":
    main()

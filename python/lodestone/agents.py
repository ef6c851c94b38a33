"""Agents: the trained policy and the scripted expert."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lodestone import _native, checks
from lodestone.batch import N_BLOCKS, N_EDGES, Action, Batch, Observation, flatten, parts_of, row_of

# Nodes, edges, and globals.
Parts: TypeAlias = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]


class Expert:
    """The scripted expert, which sees the full state of the world and builds almost any blueprint.

    It is stateless: its actions depend only on the current state of the world.
    """

    def act(self, env: Any) -> Any:
        """Returns what `env.step` accepts: one action, a batch, or one action per PettingZoo agent."""
        target = Target(env)
        return target.put(target.batch.worlds.expert())


class Policy:
    """A trained policy with frozen weights.

    `act` takes an environment of this package, in any observation format. `predict` takes observations only, as
    Stable-Baselines3 policies do; policies that draw moves from proposals (`policy.network.move_head = "mixture"`) refuse
    it, because an observation does not tell what is proposed. Copies and pickles continue with the same sampled actions.

    Args:
        native: The native policy. Use `Policy.pretrained` or `Policy.load` to create it.
        action: Format of the actions that `predict` returns: `native` or `flat`, as for `lodestone.batch.Batch`.
    """

    def __init__(self, native: _native.Policy, action: Literal["native", "flat"] = "native") -> None:
        if not isinstance(native, _native.Policy):
            raise checks.refusal("native", native, "a native policy: use Policy.pretrained() or Policy.load(path)")
        checks.one_of("action", action, ("native", "flat"))
        self.native = native
        self.flat_action = action == "flat"
        self.features: dict[str, Any] = json.loads(native.features)

    @classmethod
    def pretrained(cls, action: Literal["native", "flat"] = "native") -> Policy:
        """Returns the policy that ships with the package.

        It draws its moves from proposals, so it acts through `act(env)`, whatever the environment's `features`.
        """
        return cls(_native.Policy.pretrained(), action)

    @classmethod
    def load(cls, path: str | os.PathLike[str], action: Literal["native", "flat"] = "native") -> Policy:
        """Loads a policy from a file written by `lodestone export`."""
        if not isinstance(path, (str, os.PathLike)):
            raise checks.refusal("path", path, "the path of a file")
        checks.one_of("action", action, ("native", "flat"))
        return cls(_native.Policy.load(path), action)

    @property
    def version(self) -> int:
        """Version of the weights."""
        return self.native.version

    def seed(self, seed: int) -> None:
        """Seeds the random number generator for sampled actions."""
        self.native.seed(checks.whole("seed", seed, 0, 2**64 - 1))

    def act(self, env: Any, deterministic: bool = True) -> Any:
        """Returns what `env.step` accepts: one action, a batch, or one action per PettingZoo agent.

        With `deterministic`, takes the most probable block, and proposal if there are some, and the mean move. Otherwise
        samples actions.
        """
        deterministic = checks.flag("deterministic", deterministic)
        target = Target(env)
        batch = target.batch
        if self.native.n_grippers != batch.n_grippers:
            raise ValueError(f"env: a policy for {self.native.n_grippers} grippers cannot act with {batch.n_grippers}")
        nd, ed, gd = self.native.sizes
        shapes = ((batch.n, N_BLOCKS, nd), (batch.n, N_EDGES, ed), (batch.n, gd))
        seen = _three([np.empty(shape, np.float32) for shape in shapes])
        batch.worlds.observe(self.native.features, seen)
        actions, *_ = self.native.act(*seen, not deterministic, batch.worlds)
        return target.put(actions)

    def predict(
        self,
        observation: Observation,
        state: None = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Action, None]:
        """Returns actions for one observation or a batch, either a dictionary or flat, and None as the state."""
        del state, episode_start
        deterministic = checks.flag("deterministic", deterministic)
        parts, single = self._parts(observation)
        (choices, moves), *_ = self.native.act(*parts, not deterministic)
        n, moves = len(choices), moves.clip(-1.0, 1.0)
        actions: Action = {"choices": choices, "moves": moves}
        if self.flat_action:
            actions = flatten(choices, moves).reshape(n, -1)
        return (row_of(actions, 0) if single else actions), None

    def evaluate(self, observation: Observation) -> NDArray[np.float32]:
        """Returns the values [n] of a batch of observations: expected returns in units of reward."""
        return self.native.act(*self._parts(observation)[0], False)[2]

    def _parts(self, observation: Observation) -> tuple[Parts, bool]:
        """Returns a batch of observations in parts, and whether it was a single one."""
        nd, ed, gd = self.native.sizes
        shapes = ((N_BLOCKS, nd), (N_EDGES, ed), (gd,))
        names = ("nodes", "edges", "globals")
        if isinstance(observation, Mapping):
            whole = parts_of("observation", observation, names)
            parts = [checks.array(f"observation: {name}", part) for name, part in zip(names, whole, strict=True)]
            single = parts[0].ndim == 2
            n = 1 if single or parts[0].ndim == 0 else len(parts[0])
        else:
            flat = checks.array("observation", observation, "an array of numbers, or of nodes, edges, and globals")
            ends = np.cumsum([int(np.prod(shape)) for shape in shapes])
            if flat.ndim not in (1, 2) or flat.shape[-1] != ends[-1]:
                expected = f"({ends[-1]},), or a batch of these"
                raise ValueError(f"observation has shape {flat.shape}: this policy expects {expected}")
            single = flat.ndim == 1
            flat = flat.reshape(-1, ends[-1])
            n, parts = len(flat), np.split(flat, ends[:-1], axis=1)
        for name, part, shape in zip(names, parts, shapes, strict=True):
            if part.size != n * np.prod(shape):
                raise ValueError(f"observation: {name} has shape {part.shape}: this policy expects {(n, *shape)}")
            if not np.isfinite(part).all():
                raise ValueError(f"observation: {name} has entries that are not finite")
        pairs = zip(parts, shapes, strict=True)
        return _three([np.ascontiguousarray(part, np.float32).reshape(n, *shape) for part, shape in pairs]), single


class Target:
    """An environment of this package, unwrapped."""

    def __init__(self, env: Any) -> None:
        self.env = getattr(env, "unwrapped", env)
        batch = getattr(self.env, "batch", None)
        if not isinstance(batch, Batch):
            raise checks.refusal("env", env, "an environment of lodestone")
        self.batch = batch

    def put(self, actions: tuple[NDArray[np.int64], NDArray[np.float32]]) -> Any:
        """Converts native actions to the environment's action format."""
        if hasattr(self.env, "possible_agents"):
            return self.env.from_native(*actions)
        made = self.batch.from_native(*actions)
        return made if hasattr(self.env, "num_envs") else row_of(made, 0)


def _three(parts: list[NDArray[np.float32]]) -> Parts:
    nodes, edges, globals_ = parts
    return nodes, edges, globals_

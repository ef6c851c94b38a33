"""Gymnasium vector environment: `gymnasium.make_vec("Lodestone/Assembly-v0", num_envs=32)`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from lodestone import checks
from lodestone.batch import DIVERGED, MAX_WORLDS, SUCCESS, TIME_LIMIT, Action, Batch, Observation, row_of
from lodestone.env import checked


class AssemblyVectorEnv(VectorEnv[Observation, Action, np.ndarray]):
    """`AssemblyEnv` worlds that step in parallel on native threads, without the global interpreter lock.

    Behaves like `gymnasium.vector.SyncVectorEnv` over the same number of `AssemblyEnv`s: world i yields the same
    episodes as an environment reset with seed + i.

    Args:
        num_envs: Number of worlds, up to 16,384. MemoryError if there is no memory for them.
        autoreset_mode: When a world starts a new episode after one ends: `NextStep`, `SameStep`, or `Disabled`, as
            defined by Gymnasium. Also in `metadata["autoreset_mode"]`.
        copy: If False, each step overwrites the arrays returned by the previous step, so copy what you need to keep.
        render_mode: `rgb_array` makes `render` return an image of each world. `human` is only for single worlds.
        render_size: Width and height of an image in pixels.
        **world: Arguments of `lodestone.batch.Batch`: `blueprint`, `starts`, `shuffle_blocks`, `settings`, `features`,
            `observation`, `action`, `mask`, `noise`, `num_threads`.
    """

    metadata: dict[str, Any] = {
        "render_modes": ["rgb_array"],
        "render_fps": 10,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        render_mode: str | None = None,
        render_size: tuple[int, int] = (640, 480),
        **world: Any,
    ) -> None:
        num_envs = checks.whole("num_envs", num_envs, 1, MAX_WORLDS)
        checks.one_of("render_mode", render_mode, (None, "rgb_array"), " (human is for single worlds)")
        render_size = checks.size_of("render_size", render_size)
        if not isinstance(autoreset_mode, AutoresetMode):
            checks.one_of("autoreset_mode", autoreset_mode, [mode.value for mode in AutoresetMode])
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.num_envs, self.copy = num_envs, checks.flag("copy", copy)
        self.batch = Batch(num_envs, **world)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.render_mode, self.render_size = render_mode, render_size
        self.single_observation_space = self.batch.observation_space
        self.single_action_space = self.batch.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        # With `copy`, callers never see these arrays.
        self._observation = self.batch.empty()
        # Whether no episode has begun yet.
        self.is_new = True
        self._ended = np.zeros(num_envs, np.bool_)
        self._seeded = np.zeros(num_envs, np.bool_)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts episodes in all worlds, or in those selected by `options["reset_mask"]` [num_envs].

        A single seed expands to seed, seed + 1, and so on. `options` may also set a `blueprint` and a `start`.
        """
        self.batch.check_open()
        options = dict(checks.mapping("options", options))
        mask = self._mask(options.pop("reset_mask", None))
        options = checked(options)
        seeds = self._seeds(seed)
        for row in np.flatnonzero(mask & ~self._seeded).tolist():
            if seeds[row] is None:
                seeds[row] = int(self.np_random.integers(2**63))
        self.batch.reset(mask, seeds, options, self._observation)
        self.is_new = False
        self._seeded |= mask
        self._ended &= ~mask
        return self._observed(), self._with_episodes({}, mask)

    def step(
        self, actions: Action
    ) -> tuple[Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Steps every world. In `NextStep` mode, worlds whose episode ended in the previous step start a new one."""
        self.batch.check_open()
        resets = self._ended
        if self.autoreset_mode == AutoresetMode.DISABLED and resets.any():
            row = int(np.flatnonzero(resets)[0])
            raise ValueError(f"the episode of environment {row} has ended: reset it with options['reset_mask']")
        out = self._observation
        rewards, statuses, terms = self.batch.step(actions, resets, out)
        terminations = statuses == SUCCESS
        truncations = (statuses == TIME_LIMIT) | (statuses == DIVERGED)
        ended = terminations | truncations
        stepped = ~resets
        infos: dict[str, Any] = {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP:
            stepped = ~ended
            self._ended = np.zeros(self.num_envs, np.bool_)
            if ended.any():
                infos = self._finals(ended, statuses, terms, out)
                self.batch.reset(ended, [None] * self.num_envs, {}, out)
                resets = ended
        else:
            self._ended = ended
        if stepped.any():
            diverged = (statuses == DIVERGED) & stepped
            for name, values in (("is_success", terminations & stepped), ("diverged", diverged)):
                infos[name], infos[f"_{name}"] = values, stepped.copy()
            infos["reward_terms"], infos["_reward_terms"] = np.where(stepped[:, None], terms, 0), stepped.copy()
        return self._observed(), rewards, terminations, truncations, self._with_episodes(infos, resets)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Returns an image of each world with its goal in the corner, [height, width, 3] of unsigned bytes."""
        self.batch.check_open()
        if self.render_mode is None:
            return None
        return tuple(self.batch.worlds.picture(row, *self.render_size) for row in range(self.num_envs))

    def action_masks(self) -> NDArray[np.bool_]:
        """Returns which picks among proposals each world offers [num_envs, grippers · 528], as `AssemblyEnv` does."""
        return self.batch.action_masks()

    def scene(self, row: int) -> dict[str, Any]:
        """Returns the state of a world in the format of `AssemblyEnv.scene`."""
        self.batch.check_open()
        return self.batch.worlds.scene(checks.whole("row", row, 0, self.num_envs - 1))

    def set_scene(self, row: int, scene: Mapping[str, Any]) -> Observation:
        """Begins a world's episode anew in a scene, as `AssemblyEnv.set_scene` does; returns all observations."""
        self.batch.set_scene(checks.whole("row", row, 0, self.num_envs - 1), scene, self._observation)
        self._ended[row] = False
        return self._observed()

    def close_extras(self, **kwargs: Any) -> None:
        """Gives the worlds up. Afterward, all methods that need them raise an error."""
        del kwargs
        self.batch.close()

    def _seeds(self, seed: Any) -> list[int | None]:
        """Returns a seed for each world. A single one also seeds the generator of this environment."""
        if seed is None:
            return [None] * self.num_envs
        seed = seed.tolist() if isinstance(seed, np.ndarray) else seed
        if not isinstance(seed, Iterable) or isinstance(seed, (str, bytes)):
            first = checks.whole("seed", seed, 0, note=", a list with one for each environment, or None")
            self._np_random, self._np_random_seed = seeding.np_random(first)
            return [first + row for row in range(self.num_envs)]
        seeds = [checks.seed_of(f"seed[{row}]", one) for row, one in enumerate(seed)]
        if len(seeds) != self.num_envs:
            raise ValueError(f"seed has {len(seeds)} entries: expected {self.num_envs}, one for each environment")
        return seeds

    def _observed(self) -> Observation:
        return deepcopy(self._observation) if self.copy else self._observation

    def _mask(self, mask: Any) -> NDArray[np.bool_]:
        if mask is None:
            return np.ones(self.num_envs, np.bool_)
        mask = checks.array("options['reset_mask']", mask, f"booleans of shape ({self.num_envs},)")
        if mask.dtype != np.bool_ or mask.shape != (self.num_envs,) or not mask.any():
            expected = f"booleans of shape ({self.num_envs},), at least one of them true"
            raise ValueError(f"options['reset_mask'] is {mask.dtype} of shape {mask.shape}: expected {expected}")
        if self.is_new and not mask.all():
            raise ValueError("options['reset_mask'] leaves out environments that have no episode yet")
        return mask

    def _finals(
        self, ended: NDArray[np.bool_], statuses: NDArray[np.uint8], terms: NDArray[np.float32], out: Observation
    ) -> dict[str, Any]:
        """Returns the final observations and infos of ended episodes as Gymnasium infos."""
        infos: dict[str, Any] = {}
        for row in np.flatnonzero(ended).tolist():
            seen = row_of(out, row)
            seen = {name: x.copy() for name, x in seen.items()} if isinstance(seen, dict) else seen.copy()
            success, diverged = bool(statuses[row] == SUCCESS), bool(statuses[row] == DIVERGED)
            last = {"is_success": success, "diverged": diverged, "reward_terms": terms[row]}
            infos = self._add_info(infos, {"final_obs": seen, "final_info": last}, row)
        return infos

    def _with_episodes(self, infos: dict[str, Any], begun: NDArray[np.bool_]) -> dict[str, Any]:
        """Adds the reset infos of episodes that have just started."""
        for row in np.flatnonzero(begun).tolist():
            infos = self._add_info(infos, self.batch.about(row), row)
        return infos

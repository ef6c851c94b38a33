"""Vectorized environment for Stable-Baselines3.

from lodestone.sb3 import AssemblyVecEnv

model = PPO("MlpPolicy", AssemblyVecEnv(32, blueprint="2_000", starts="near-goal"), n_steps=128)
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from lodestone import checks
from lodestone.env import checked
from lodestone.vector import AssemblyVectorEnv


class AssemblyVecEnv(VecEnv):
    """`lodestone.AssemblyVectorEnv` as a Stable-Baselines3 `VecEnv`. Wrap it in `VecMonitor` for statistics.

    Args:
        num_envs: Number of worlds.
        render_mode: `rgb_array` makes `render` return images.
        **world: Arguments of `lodestone.batch.Batch`. Observations and actions are `flat` by default because
            Stable-Baselines3 does not support dictionary actions. With `action="proposals"`, MaskablePPO of
            sb3-contrib picks only what is offered.
    """

    def __init__(self, num_envs: int, render_mode: str | None = None, **world: Any) -> None:
        world = {"observation": "flat", "action": "flat"} | world
        self.envs = AssemblyVectorEnv(num_envs, autoreset_mode="SameStep", render_mode=render_mode, **world)
        self.batch = self.envs.batch
        self._actions: Any = None
        num_envs = self.envs.num_envs
        self.render_mode = render_mode
        super().__init__(num_envs, self.envs.single_observation_space, self.envs.single_action_space)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seeds the worlds of the next reset: the first one with `seed`, the second one with `seed` + 1, and so on."""
        self.batch.check_open()
        return super().seed(checks.seed_of("seed", seed))

    def set_options(self, options: Sequence[Mapping[str, Any]] | Mapping[str, Any] | None = None) -> None:
        """Chooses the `blueprint` and the `start` of the next reset, for all worlds or with a list for each."""
        self.batch.check_open()
        if isinstance(options, (list, tuple)):
            if len(options) != self.num_envs:
                raise ValueError(f"options has {len(options)} entries: expected {self.num_envs}, one for each world")
            super().set_options([dict(checked(one, f"options[{row}]")) for row, one in enumerate(options)])
        else:
            super().set_options(dict(checked(options)))

    def reset(self) -> Any:
        """Starts episodes in all worlds, with seeds from `seed` and `blueprint` and `start` from `set_options`."""
        self.batch.check_open()
        seeds = list(self._seeds) if any(seed is not None for seed in self._seeds) else None
        if all(options == self._options[0] for options in self._options):
            observation, infos = self.envs.reset(seed=seeds, options=self._options[0])
            self.reset_infos = [_row(infos, row) for row in range(self.num_envs)]
        else:
            if self.envs.is_new:
                self.envs.reset(seed=seeds)
            for row, options in enumerate(self._options):
                mask = np.arange(self.num_envs) == row
                observation, infos = self.envs.reset(seed=seeds, options={**options, "reset_mask": mask})
                self.reset_infos[row] = _row(infos, row)
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: np.ndarray) -> None:
        """Stores the actions for `step_wait`."""
        self.batch.check_open()
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Steps every world. A world whose episode ends starts the next one in the same step."""
        observation, rewards, terminations, truncations, infos = self.envs.step(self._actions)
        dones = terminations | truncations
        rows: list[dict[str, Any]] = []
        for row in range(self.num_envs):
            if dones[row]:
                info = _row(infos["final_info"], row)
                info["terminal_observation"] = infos["final_obs"][row]
                info["TimeLimit.truncated"] = bool(truncations[row])
                self.reset_infos[row] = {name: infos[name][row] for name in ("blueprint", "start")}
            else:
                info = {"is_success": False, "diverged": False, "reward_terms": infos["reward_terms"][row]}
            rows.append(info)
        return observation, rewards.astype(np.float32), dones, rows

    def close(self) -> None:
        """Closes the environment."""
        self.envs.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Returns an image of each world, or None per world without a `render_mode`."""
        return self.envs.render() or [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Returns an attribute of the batch, once per index. All worlds share it."""
        checks.text("attr_name", attr_name, "the name of an attribute")
        return [getattr(self.envs, attr_name) for _ in self._rows(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Sets an attribute of all worlds."""
        checks.text("attr_name", attr_name, "the name of an attribute")
        self._rows(indices)
        setattr(self.envs, attr_name, value)

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Calls a method of the batch once and returns its result once per index; of `action_masks`, each world's row."""
        checks.text("method_name", method_name, "the name of a method")
        rows = self._rows(indices)
        result = getattr(self.envs, method_name)(*method_args, **method_kwargs)
        return [result[row] if method_name == "action_masks" else result for row in rows]

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Returns False per index: worlds are never wrapped."""
        del wrapper_class
        return [False for _ in self._rows(indices)]

    def _rows(self, indices: Any) -> list[int]:
        """Returns the worlds that are meant: all, one, or several."""
        self.batch.check_open()
        several = self._get_indices(indices)
        if not isinstance(several, Iterable) or isinstance(several, (str, bytes)):
            several = [several]
        return [checks.whole("indices", row, 0, self.num_envs - 1) for row in several]


def _row(infos: dict[str, Any], row: int) -> dict[str, Any]:
    """Extracts the info dictionary of one world from Gymnasium's batched infos."""
    return {name: values[row] for name, values in infos.items() if not name.startswith("_") and infos[f"_{name}"][row]}

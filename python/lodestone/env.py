"""Gymnasium environment of one world: `gymnasium.make("Lodestone/Assembly-v0")`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from lodestone import checks
from lodestone.batch import DIVERGED, SUCCESS, TIME_LIMIT, Action, Batch, Observation, Options, row_of
from lodestone.window import Window

_MODES = (None, "human", "rgb_array")
_ONE = np.ones(1, np.bool_)
_NONE = np.zeros(1, np.bool_)


class AssemblyEnv(gymnasium.Env[Observation, Action]):
    """Two grippers assemble magnet blocks on the ground until a blueprint is complete.

    A step lasts a tenth of a second. An episode terminates when the blueprint is complete. It is truncated at the time
    limit of 100 steps, or if the physics diverges, which is rare (`info["diverged"]`).

    The reward is the change in a potential: 1 for each required connection, -1 for each other connection, up to 1 for
    each required pair as its blocks and magnets get closer, minus up to 1 for hard contacts. `info["reward_terms"]`
    holds the five terms named in `REWARD_TERMS`, and `info["is_success"]` is true once the blueprint is complete. The
    info returned by `reset` holds the goal's `blueprint` and the kind of `start`.

    The same seed yields the same episodes. `reset(options={"blueprint": ID, "start": "near-goal:1"})` sets the
    blueprint, the start, or both. To draw from several blueprints, such as a split, use the argument `blueprint`.

    Args:
        render_mode: `human` for a window (needs pygame-ce), `rgb_array` for images [height, width, 3] of unsigned
            bytes.
        render_size: Width and height of an image in pixels, 32 to 4096.
        **world: Arguments of `lodestone.batch.Batch`: `blueprint`, `starts`, `shuffle_blocks`, `settings`, `features`,
            `observation`, `action`, `mask`, `noise`.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 10}

    def __init__(self, render_mode: str | None = None, render_size: tuple[int, int] = (640, 480), **world: Any) -> None:
        checks.one_of("render_mode", render_mode, _MODES)
        self.render_mode, self.render_size = render_mode, checks.size_of("render_size", render_size)
        self.batch = Batch(1, **{"num_threads": 1} | world)
        self.observation_space, self.action_space = self.batch.observation_space, self.batch.action_space
        self._window: Window | None = None
        self._seeded = False

    def reset(
        self, *, seed: int | None = None, options: Options | Mapping[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode."""
        self.batch.check_open()
        options, seed = checked(options), checks.seed_of("seed", seed)
        super().reset(seed=seed)
        if seed is None and not self._seeded:
            seed = int(self.np_random.integers(2**63))
        out = self.batch.empty()
        self.batch.reset(_ONE, [seed], options, out)
        self._seeded = True
        self._show()
        return row_of(out, 0), self.batch.about(0)

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advances the world by one step."""
        out = self.batch.empty()
        rewards, statuses, terms = self.batch.step(action, _NONE, out, "action")
        status = int(statuses[0])
        info = {"is_success": status == SUCCESS, "diverged": status == DIVERGED, "reward_terms": terms[0]}
        self._show()
        return row_of(out, 0), float(rewards[0]), status == SUCCESS, status in (TIME_LIMIT, DIVERGED), info

    def render(self) -> NDArray[np.uint8] | None:
        """Returns an image of the world with its goal in the corner. `human` mode draws every step and returns None."""
        self.batch.check_open()
        if self.render_mode is None:
            gymnasium.logger.warn("render() does nothing without a render_mode: human or rgb_array")
            return None
        if self.render_mode == "human":
            self._show()
            return None
        return self.batch.worlds.picture(0, *self.render_size)

    def close(self) -> None:
        """Closes the window and gives the world up. Afterward, all methods that need the world raise an error."""
        if self._window is not None:
            self._window.close()
            self._window = None
        self.batch.close()

    def __getstate__(self) -> dict[str, Any]:
        """Returns what a copy or a pickle holds: everything but the window, of which a copy opens its own."""
        return {**self.__dict__, "_window": None}

    def action_masks(self) -> NDArray[np.bool_]:
        """Returns which picks among proposals are offered [grippers · 528], as MaskablePPO of sb3-contrib expects.

        Gripper g may take pick p if entry g · 528 + p is true. ValueError if the action is not `proposals`.
        """
        return self.batch.action_masks()[0]

    def scene(self) -> dict[str, Any]:
        """Returns the state of the world, with z up and lengths in meters.

        The dictionary holds `positions` [16, 3] and `orientations` [16, 4] (quaternions x, y, z, w) of the blocks,
        their `half_extents` [16, 3] and `speeds` [16] in m/s, `connections` [k, 2] between blocks, the block `held`
        [grippers] in the last step (-1 for none), `in_blueprint` [16], and the number of `heavy_contacts`.
        """
        return self.batch.worlds.scene(0)

    def set_scene(self, scene: Mapping[str, Any]) -> Observation:
        """Begins the episode anew in a scene, with the same goal and no steps taken; returns the observation.

        Of what `scene` returns, only `positions`, `orientations`, and `connections` count: the blocks are at rest, and
        the grippers hold nothing. What follows depends only on these, the episode's goal and settings, and the actions.
        ValueError if a block is in another one by more than 8 cm or in the ground by more than 10 cm, or if connected
        blocks do not fit together, as while grippers tear them apart.
        """
        out = self.batch.empty()
        self.batch.set_scene(0, scene, out)
        self._show()
        return row_of(out, 0)

    def _show(self) -> None:
        if self.render_mode == "human":
            if self._window is None:
                self._window = Window("Lodestone", self.render_size, self.metadata["render_fps"])
            self._window.show(self.batch.worlds.picture(0, *self.render_size))


def checked(options: Options | Mapping[str, Any] | None, argument: str = "options") -> Mapping[str, Any]:
    """Validates the options of `reset` and returns them, or an empty mapping for None."""
    options = checks.mapping(argument, options)
    for name, value in options.items():
        if name not in ("blueprint", "start"):
            raise ValueError(f"option {name!r} is unknown: expected blueprint or start")
        if value is not None:
            checks.text(f"option {name!r}", value, "a text")
    return options

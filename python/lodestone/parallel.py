"""PettingZoo parallel environment of one world, with one agent per gripper.

from lodestone.parallel import parallel_env

env = parallel_env(blueprint="4_000")
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from lodestone import checks
from lodestone.batch import (
    DIVERGED,
    N_BLOCKS,
    N_FLAT,
    N_MOVES,
    SUCCESS,
    TIME_LIMIT,
    Batch,
    arrays,
    parts_of,
    unflatten,
)
from lodestone.env import checked
from lodestone.window import Window

_MODES = (None, "human", "rgb_array")
_ONE = np.ones(1, np.bool_)
_NONE = np.zeros(1, np.bool_)


class AssemblyParallelEnv(ParallelEnv):
    """The world of `lodestone.AssemblyEnv` with one agent per gripper: `gripper_0` and `gripper_1`.

    Agents share the goal and the reward, and their episodes end together. Each agent's own entries come first in its
    observation: the first of the two node features that mark held blocks is its own, and the first half of the globals
    describes its own gripper.

    An action is a dictionary of `choice`, a block from 0 to 15, and `move` [6], its linear and angular velocity in the
    block's frame as fractions of the speed limits. With `action="flat"`, it is 22 numbers in [-1, 1]: a score for each
    block, and the move of the block with the highest score. If both agents choose the same block, it moves by the mean
    of their moves.

    Args:
        render_mode: `human` for a window (needs pygame-ce), `rgb_array` for images [height, width, 3] of unsigned
            bytes.
        render_size: Width and height of an image in pixels.
        **world: Arguments of `lodestone.batch.Batch`: `blueprint`, `starts`, `shuffle_blocks`, `settings`, `features`,
            `observation`, `action`, `mask`.
    """

    metadata: dict[str, Any] = {
        "name": "lodestone_assembly_v0",
        "render_modes": ["human", "rgb_array"],
        "render_fps": 10,
        "is_parallelizable": True,
    }

    def __init__(self, render_mode: str | None = None, render_size: tuple[int, int] = (640, 480), **world: Any) -> None:
        checks.one_of("render_mode", render_mode, _MODES)
        self.render_mode, self.render_size = render_mode, checks.size_of("render_size", render_size)
        observation = world.pop("observation", "features")
        checks.one_of("observation", observation, ("features", "flat"))
        # Two agents that pick without knowing of each other are not what proposals are for.
        checks.one_of("action", world.get("action", "native"), ("native", "flat"))
        self.flat_observation = observation == "flat"
        # The batch keeps dictionary observations because `_views` rearranges the parts for each agent before
        # flattening.
        self.batch = Batch(1, **{"num_threads": 1} | world)
        self.flat_action = self.batch.flat_action
        self.possible_agents = [f"gripper_{gripper}" for gripper in range(self.batch.n_grippers)]
        self.agents: list[str] = []
        self._window: Window | None = None
        self._random: np.random.Generator | None = None
        single = self.batch.observation_space
        self._observation_spaces = {
            agent: spaces.flatten_space(single) if self.flat_observation else deepcopy(single)
            for agent in self.possible_agents
        }
        self._action_spaces = {agent: self._action_space() for agent in self.possible_agents}

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Returns the agent's observation space: a dictionary of features, or flat."""
        checks.one_of("agent", agent, self.possible_agents)
        return self._observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Returns the agent's action space."""
        checks.one_of("agent", agent, self.possible_agents)
        return self._action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Starts an episode; `options` may name a `blueprint` and a `start`."""
        self.batch.check_open()
        # PettingZoo's API test passes {"options": 1} and expects no error.
        given = checks.mapping("options", options)
        options = checked({name: value for name, value in given.items() if name != "options"})
        seed = checks.seed_of("seed", seed)
        if seed is not None or self._random is None:
            self._random, _ = seeding.np_random(seed)
            seed = seed if seed is not None else int(self._random.integers(2**63))
        out = self.batch.empty()
        self.batch.reset(_ONE, [seed], options, out)
        self.agents = list(self.possible_agents)
        self._show()
        return self._views(out), {agent: self.batch.about(0) for agent in self.agents}

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Advances the world by one step."""
        self.batch.check_open()
        out = self.batch.empty()
        rewards, statuses, terms = self.batch.step(self._joint(actions), _NONE, out)
        status, agents = int(statuses[0]), self.agents
        truncated = status in (TIME_LIMIT, DIVERGED)
        infos = {
            agent: {"is_success": status == SUCCESS, "diverged": status == DIVERGED, "reward_terms": terms[0].copy()}
            for agent in agents
        }
        if status == SUCCESS or truncated:
            self.agents = []
        self._show()
        return (
            {agent: view for agent, view in self._views(out).items() if agent in agents},
            dict.fromkeys(agents, float(rewards[0])),
            dict.fromkeys(agents, status == SUCCESS),
            dict.fromkeys(agents, truncated),
            infos,
        )

    def render(self) -> NDArray[np.uint8] | None:
        """Returns an image of the world with its goal in the corner. `human` mode draws every step and returns None."""
        self.batch.check_open()
        if self.render_mode == "rgb_array":
            return self.batch.worlds.picture(0, *self.render_size)
        self._show()
        return None

    def close(self) -> None:
        """Closes the window and gives the world up. Afterward, all methods that need the world raise an error."""
        if self._window is not None:
            self._window.close()
            self._window = None
        self.batch.close()

    def __getstate__(self) -> dict[str, Any]:
        """Returns what a copy or a pickle holds: everything but the window, of which a copy opens its own."""
        return {**self.__dict__, "_window": None}

    def scene(self) -> dict[str, Any]:
        """Returns the state of the world in the format of `lodestone.AssemblyEnv.scene`."""
        return self.batch.worlds.scene(0)

    def from_native(self, choices: NDArray[np.int64], moves: NDArray[np.float32]) -> dict[str, Any]:
        """Converts choices [1, grippers] and moves [1, 16, 6] to one action per agent."""
        self.batch.check_open()
        choices = checks.blocks("choices", choices, (1, len(self.possible_agents)))
        moves = checks.numbers("moves", moves, (1, N_BLOCKS, N_MOVES))
        moves = self.batch.within_mask(moves.clip(-1.0, 1.0))
        made: dict[str, Any] = {}
        for gripper, agent in enumerate(self.possible_agents):
            choice = checks.whole(f"choices[0, {gripper}]", int(choices[0, gripper]), 0, N_BLOCKS - 1)
            move = moves[0, choice].copy()
            if self.flat_action:
                scores = np.full(N_BLOCKS, -1.0, np.float32)
                scores[choice] = 1.0
                made[agent] = np.concatenate([scores, move])
            else:
                made[agent] = {"choice": choice, "move": move}
        return made

    def _action_space(self) -> spaces.Space[Any]:
        if self.flat_action:
            return spaces.Box(-1.0, 1.0, (N_FLAT,), np.float32)
        move = spaces.Box(-1.0, 1.0, (N_MOVES,), np.float32)
        return spaces.Dict({"choice": spaces.Discrete(N_BLOCKS), "move": move})

    def _joint(self, actions: Mapping[str, Any]) -> Any:
        """Combines the agents' actions into an action of the batch."""
        if not isinstance(actions, Mapping):
            raise checks.refusal("actions", actions, "a dictionary with an action for each agent")
        flat = np.full((1, len(self.possible_agents), N_FLAT), -1.0, np.float32)
        for gripper, agent in enumerate(self.possible_agents):
            if agent not in actions:
                raise ValueError(f"actions: no action for agent {agent}")
            action = actions[agent]
            if self.flat_action:
                flat[0, gripper] = checks.numbers(f"actions: the action of {agent}", action, (N_FLAT,))
                continue
            if not isinstance(action, Mapping):
                raise checks.refusal(f"actions: the action of {agent}", action, "a dictionary of choice and move")
            choice, move = parts_of(f"actions: the action of {agent}", action, ("choice", "move"))
            choice = checks.whole(f"actions: the choice of {agent}", choice, 0, N_BLOCKS - 1)
            flat[0, gripper, choice] = 1.0
            flat[0, gripper, N_BLOCKS:] = checks.numbers(f"actions: the move of {agent}", move, (N_MOVES,))
        if self.flat_action:
            return flat
        choices, moves = unflatten(flat)
        return {"choices": choices, "moves": moves}

    def _views(self, out: Any) -> dict[str, Any]:
        views = {}
        for gripper, agent in enumerate(self.possible_agents):
            nodes, edges, globals_ = (out[name][0].copy() for name in ("nodes", "edges", "globals"))
            if gripper == 1:
                nodes[:, [1, 2]] = nodes[:, [2, 1]]
                globals_ = np.roll(globals_, len(globals_) // 2)
            view = {"nodes": nodes, "edges": edges, "globals": globals_}
            # `spaces.flatten` would sort the parts by name.
            views[agent] = np.concatenate([part.ravel() for part in arrays(view)]) if self.flat_observation else view
        return views

    def _show(self) -> None:
        if self.render_mode == "human":
            if self._window is None:
                self._window = Window("Lodestone", self.render_size, self.metadata["render_fps"])
            self._window.show(self.batch.worlds.picture(0, *self.render_size))


def parallel_env(**kwargs: Any) -> AssemblyParallelEnv:
    """Creates the environment. PettingZoo's own environments use this name."""
    return AssemblyParallelEnv(**kwargs)

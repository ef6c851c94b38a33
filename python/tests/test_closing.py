"""Tests what a closed environment does, and that windows are independent of each other.

python -m unittest discover -s python/tests
"""

from __future__ import annotations

import os
import unittest
from collections.abc import Callable
from typing import Any

import gymnasium
import lodestone
import numpy as np
from gymnasium.error import ClosedEnvironmentError
from lodestone.parallel import parallel_env
from lodestone.sb3 import AssemblyVecEnv


class Closing(unittest.TestCase):
    def test_a_closed_environment_says_so(self) -> None:
        single, batch = lodestone.AssemblyEnv(blueprint="2_000"), lodestone.AssemblyVectorEnv(2, blueprint="2_000")
        pair, sb3 = parallel_env(blueprint="2_000"), AssemblyVecEnv(2, blueprint="2_000")
        policy, expert = lodestone.Policy.pretrained(), lodestone.Expert()
        choices, moves = np.zeros((1, 2), np.int64), np.zeros((1, 16, 6), np.float32)
        sample = {agent: pair.action_space(agent).sample() for agent in pair.possible_agents}
        calls: dict[Any, list[Callable[[], Any]]] = {
            single: [lambda: single.step(single.action_space.sample()), single.scene],
            batch: [lambda: batch.step(batch.action_space.sample()), lambda: batch.scene(0)],
            pair: [lambda: pair.step(sample), pair.scene, lambda: pair.from_native(choices, moves)],
            sb3: [
                lambda: sb3.step(np.zeros((2, 44))),
                lambda: sb3.step_async(np.zeros((2, 44))),
                sb3.step_wait,
                sb3.get_images,
                sb3.seed,
                sb3.set_options,
                lambda: sb3.get_attr("num_envs"),
                lambda: sb3.set_attr("render_size", (64, 64)),
                lambda: sb3.env_method("scene", 0),
                lambda: sb3.env_is_wrapped(gymnasium.Wrapper),
            ],
        }
        for env, methods in calls.items():
            env.reset()
            env.close()
            # Twice does no harm.
            env.close()
            methods += [env.reset, lambda env=env: policy.act(env), lambda env=env: expert.act(env)]
            methods += [env.render] if env is not sb3 else []
            for at, method in enumerate(methods):
                with self.subTest(type(env).__name__, at=at):
                    with self.assertRaisesRegex(ClosedEnvironmentError, "the environment is closed: make a new one"):
                        method()

    def test_windows_are_independent(self) -> None:
        os.environ["SDL_VIDEODRIVER"] = "dummy"
        given = {"blueprint": "2_000", "render_mode": "human"}
        first, second = lodestone.AssemblyEnv(**given), parallel_env(render_size=(96, 64), **given)
        for env in (first, second):
            env.reset(seed=1)
        first.close()
        self.assertIsNone(second.render())
        second.step(lodestone.Expert().act(second))
        second.close()
        again = lodestone.AssemblyEnv(**given)
        again.reset(seed=1)
        again.close()


if __name__ == "__main__":
    unittest.main()

"""Tests of scenes that are set.

python -m unittest discover -s python/tests
"""

from __future__ import annotations

import copy
import pickle
import unittest
from typing import Any

import lodestone
import numpy as np
from gymnasium.utils.env_checker import data_equivalence


def played(env: Any, n: int = 30) -> list[Any]:
    """Plays as the expert does; returns all that is seen, and the last scene."""
    return [*(env.step(lodestone.Expert().act(env)) for _ in range(n)), env.scene()]


class Scenes(unittest.TestCase):
    def same(self, one: Any, other: Any) -> None:
        self.assertTrue(data_equivalence(one, other, exact=True), f"{one} is not {other}")

    def test_what_follows_depends_on_nothing_before(self) -> None:
        world = {"blueprint": "4_000", "shuffle_blocks": False}
        for start in ("scattered", "prebuilt:6_000", "near-goal:1"):
            env, new = lodestone.AssemblyEnv(**world), lodestone.AssemblyEnv(**world)
            env.reset(seed=1, options={"start": start})
            new.reset(seed=2)
            for _ in range(25):
                env.step(env.action_space.sample())
            scene = env.scene()
            with self.subTest(start):
                self.same(env.set_scene(scene), new.set_scene(scene))
                self.assertEqual(env.scene()["connections"].tolist(), scene["connections"].tolist())
                np.testing.assert_allclose(env.scene()["positions"], scene["positions"], atol=1e-6)
                self.same(played(env), played(new))

    def test_scenes_of_a_world_in_motion_are_legal(self) -> None:
        """All but those in which grippers tear two blocks apart."""
        env = lodestone.AssemblyEnv(blueprint="train", starts={"scattered": 1, "prebuilt": 1, "near-goal": 1})
        env.action_space.seed(1)
        other = lodestone.AssemblyEnv(blueprint="2_000")
        other.reset(seed=1)
        n_torn = 0
        for seed in range(12):
            env.reset(seed=seed)
            for _ in range(40):
                env.step(env.action_space.sample() if seed % 2 else lodestone.Expert().act(env))
                try:
                    other.set_scene(env.scene())
                except ValueError as error:
                    self.assertRegex(str(error), r"blocks \d+ and \d+ are connected: expected")
                    n_torn += 1
        self.assertLess(n_torn, 10)

    def test_a_scene_of_ones_own(self) -> None:
        """What a camera would tell: a built goal, with errors of a few millimeters, but for a block that lies beside."""
        env = lodestone.AssemblyEnv(blueprint="4_000", shuffle_blocks=False)
        env.reset(seed=1, options={"start": "prebuilt:4_000"})
        seen, random = env.scene(), np.random.default_rng(1)
        block = int(np.flatnonzero(seen["in_blueprint"] & (seen["positions"][:, 2] == seen["positions"][:, 2].max()))[0])
        seen["positions"] += random.uniform(-0.002, 0.002, (16, 3))
        seen["positions"][block] = [1.5, 0.0, 0.06]
        own = {
            "positions": seen["positions"].tolist(),
            "orientations": seen["orientations"],
            "connections": [pair for pair in seen["connections"].tolist() if block not in pair],
        }
        env.set_scene(own)
        self.assertTrue(played(env, 100)[-2][4]["is_success"])

    def test_a_copy_and_a_pickle_go_on_from_it(self) -> None:
        env = lodestone.AssemblyEnv(blueprint="3_000", starts="near-goal:1")
        env.reset(seed=1)
        scene = played(env)[-1]
        # The history of a world is limited, but not the number of scenes.
        for _ in range(250):
            env.set_scene(scene)
            env.action_space.seed(1)
            for _ in range(100):
                env.step(env.action_space.sample())
        made = [env, copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
        first, *others = [[*played(one), one.reset(options={"start": "as-it-is"}), *played(one)] for one in made]
        for other in others:
            self.same(first, other)

    def test_a_row_of_many(self) -> None:
        envs = lodestone.AssemblyVectorEnv(2, blueprint="4_000", shuffle_blocks=False, settings={"episode_steps": 5})
        env = lodestone.AssemblyEnv(blueprint="4_000", shuffle_blocks=False, settings={"episode_steps": 5})
        envs.reset(seed=1)
        env.reset(seed=9)
        for _ in range(5):
            after = envs.step(lodestone.Expert().act(envs))[0]
        seen, alone = envs.set_scene(1, env.scene()), env.set_scene(env.scene())
        for name, values in seen.items():
            self.same(values[0], after[name][0])
            self.same(values[1], alone[name])
        # The episode has not ended, so the next step is one.
        rewards = envs.step(lodestone.Expert().act(envs))[1]
        self.assertEqual(rewards[1], env.step(lodestone.Expert().act(env))[1])

    def test_what_is_wrong_is_told(self) -> None:
        env = lodestone.AssemblyEnv(blueprint="4_000")
        env.reset(seed=1)
        scene = env.scene()
        positions, pairs = scene["positions"], scene["connections"]
        for change, words in (
            ({"positions": positions[:3]}, r"scene: positions has shape \(3, 3\): expected \(16, 3\)"),
            ({"positions": positions * np.nan}, r"scene: block 0 is at \[NaN, NaN, NaN\]"),
            ({"positions": positions * 0}, "scene: blocks? 0 "),
            ({"orientations": scene["orientations"] * 2}, "scene: block 0 has the orientation .* unit quaternion"),
            ({"connections": [(0, 1, 2)]}, r"scene: connections has shape \(1, 3\): expected \(1, 2\)"),
            ({"connections": [(0, 16)]}, "scene: connections have the block 16: expected a block from 0 to 15"),
            ({"connections": [(0.5, 1)]}, "scene: connections has the type float64"),
            ({"connections": [(1, 0)]}, "scene: blocks 0 and 1 are connected: expected .* magnets within 0.045 m"),
            ({"connections": None}, "scene: connections is None"),
        ):
            with self.subTest(words), self.assertRaisesRegex(ValueError, words):
                env.set_scene({**scene, **change})
        with self.assertRaisesRegex(ValueError, "scene has no connections"):
            env.set_scene({"positions": positions, "orientations": scene["orientations"]})
        self.assertEqual(pairs.shape, (0, 2))
        self.same(env.scene(), scene)
        with self.assertRaisesRegex(ValueError, "no episode yet: reset it first"):
            lodestone.AssemblyEnv(blueprint="4_000").set_scene(scene)


if __name__ == "__main__":
    unittest.main()

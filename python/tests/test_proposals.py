"""Tests proposals as arrays and the actions that pick among them, alone, in batches, and with Stable-Baselines3.

python -m unittest discover -s python/tests
"""

from __future__ import annotations

import copy
import os
import pickle
import unittest
import warnings
from typing import Any

import gymnasium
import lodestone
import numpy as np
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from lodestone.batch import DIVERGED, N_PICKS
from lodestone.parallel import parallel_env
from lodestone.proposed import KINDS
from lodestone.sb3 import AssemblyVecEnv
from numpy.typing import NDArray
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.utils import get_action_masks
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env as check_env_for_sb3

ID = "Lodestone/Assembly-v0"
# The slots; those of joins and detachments begin here, one for each partner.
JOIN, DETACH, HOLD = 0, 16, 32


def members(env: Any) -> list[int]:
    return np.flatnonzero(env.unwrapped.scene()["in_blueprint"]).tolist()


def pick(block: int, slot: int) -> int:
    return block * 33 + slot


def offered_picks(masks: NDArray[np.bool_], random: np.random.Generator) -> NDArray[np.int64]:
    """Draws one offered pick for each gripper [..., grippers]."""
    scores = np.where(masks, random.random(masks.shape), -1.0)
    return scores.reshape(*masks.shape[:-1], -1, N_PICKS).argmax(axis=-1)


def rotated(orientation: NDArray[np.float32], v: NDArray[np.float32]) -> NDArray[np.float32]:
    xyz, w = orientation[:3], orientation[3]
    return v + 2 * np.cross(xyz, np.cross(xyz, v) + w * v)


class Scenes(unittest.TestCase):
    def test_a_scene_of_two_blocks(self) -> None:
        env = gymnasium.make(ID, blueprint="2_000")
        env.reset(seed=1)
        found, scene = lodestone.proposals(env), env.unwrapped.scene()
        shapes = {name: x.shape for name, x in found.items()}
        paired = {"offered": (16, 33), "moves": (16, 33, 6), "noise": (16, 33), "relations": (16, 16, 8)}
        self.assertEqual(shapes, paired | {"kinds": (33,), "partners": (33,)})
        self.assertEqual([KINDS[kind] for kind in found["kinds"]], ["join"] * 16 + ["detach"] * 16 + ["hold"])
        np.testing.assert_array_equal(found["partners"], [*range(16)] * 2 + [-1])
        offered = {(int(block), int(slot)) for block, slot in zip(*np.nonzero(found["offered"]))}
        a, b = members(env)
        self.assertEqual(offered, {(block, HOLD) for block in range(16)} | {(a, JOIN + b), (b, JOIN + a)})
        largest = np.abs(found["moves"]).max(axis=-1)
        wanted = np.where(found["offered"], np.float32(0.01) + np.float32(0.02) * largest, 0.0)
        np.testing.assert_allclose(found["noise"], wanted, rtol=1e-6)
        self.assertLessEqual(largest.max(), 1.0 + 1e-6)
        for block in range(16):
            up = rotated(scene["orientations"][block], found["moves"][block, HOLD, :3])
            # To half a meter, and one step of 0.3 m at most.
            height = scene["positions"][block, 2]
            np.testing.assert_allclose(up, [0.0, 0.0, np.clip((0.5 - height) / 0.3, 0.0, 1.0)], atol=1e-5)
        np.testing.assert_array_equal(found["relations"][[a, b], [b, a], 0], 1.0)
        for entry in (0, 4, 5):
            pairs = {(int(i), int(j)) for i, j in zip(*np.nonzero(found["relations"][..., entry]))}
            self.assertEqual(pairs, {(a, b), (b, a)})

    def test_two_grippers_share_the_way(self) -> None:
        one, two = (lodestone.AssemblyEnv(blueprint="2_000", settings={"n_grippers": n}) for n in (1, 2))
        parts = []
        for seed in range(10):
            for env in (one, two):
                env.reset(seed=seed)
            a, b = members(two)
            whole, half = (lodestone.proposals(env)["moves"][a, JOIN + b] for env in (one, two))
            parts.append(np.linalg.norm(half) / np.linalg.norm(whole))
            np.testing.assert_allclose(half, parts[-1] * whole, atol=1e-5)
        # Each move is one step at most, so the part is larger where a step does not reach the middle.
        self.assertTrue(0.5 - 1e-5 < min(parts) < 0.6 and max(parts) < 1.0 + 1e-5, parts)

    def test_a_batch_has_an_axis_more(self) -> None:
        envs = gymnasium.make_vec(ID, num_envs=3, blueprint="4_000")
        envs.reset(seed=5)
        batch = lodestone.proposals(envs)
        for row in range(3):
            env = lodestone.AssemblyEnv(blueprint="4_000")
            env.reset(seed=5 + row)
            for name, x in lodestone.proposals(env).items():
                expected = batch[name] if name in ("kinds", "partners") else batch[name][row]
                np.testing.assert_array_equal(x, expected)

    def test_after_a_divergence_they_are_finite(self) -> None:
        env = lodestone.AssemblyEnv(blueprint="2_000", action="proposals")
        env.reset(seed=1)
        before = lodestone.proposals(env)
        bad, goes_on = np.full((1, 16, 6), np.nan, np.float32), np.zeros(1, np.bool_)
        statuses = env.batch.worlds.step(np.array([[0, 1]]), bad, goes_on, [*env.batch.empty().values()])[1]
        self.assertEqual(statuses.tolist(), [DIVERGED])
        for name, x in lodestone.proposals(env).items():
            np.testing.assert_array_equal(x, before[name])


class Picks(unittest.TestCase):
    def test_a_pick_makes_the_proposed_move(self) -> None:
        native = lodestone.AssemblyEnv(blueprint="4_000")
        picks = lodestone.AssemblyEnv(blueprint="4_000", action="proposals", noise=False)
        for env in (picks, native):
            env.reset(seed=3)
        random = np.random.default_rng(1)
        for _ in range(20):
            found = lodestone.proposals(native)
            drawn = offered_picks(picks.action_masks(), random)
            (blocks, slots), moves = np.divmod(drawn, 33), np.zeros((16, 6), np.float32)
            # The first of two picks on the same block counts.
            for block, slot in reversed(list(zip(blocks, slots))):
                moves[block] = found["moves"][block, slot]
            ours, theirs = picks.step(drawn), native.step({"choices": blocks, "moves": moves})
            self.assertTrue(data_equivalence(ours, theirs, exact=True))

    def test_exact_joins_build(self) -> None:
        env = lodestone.AssemblyEnv(blueprint="2_000", action="proposals", noise=False)

        def step() -> bool:
            a, b = members(env)
            # Each comes half of the way. What is caught on the way is detached.
            wrong = np.argwhere(lodestone.proposals(env)["offered"][:, DETACH:HOLD])
            i, j, kind = (*wrong[0], DETACH) if len(wrong) else (a, b, JOIN)
            return env.step([pick(i, kind + j), pick(j, kind + i)])[2]

        for seed in range(10):
            env.reset(seed=seed)
            self.assertTrue(any(step() for _ in range(20)), seed)

    def test_noise_has_its_deviation_and_follows_the_seed(self) -> None:
        def drawn(seed: int, n: int) -> NDArray[np.float32]:
            env = lodestone.AssemblyEnv(blueprint="2_000", action="proposals")
            env.reset(seed=seed)
            picks = np.array([pick(0, HOLD), pick(5, HOLD)])
            # After a step, less than another is left, so no noise is cut off at the speed limit.
            env.step(picks)
            moves = [env.batch.to_native(picks, "action")[1] for _ in range(n)]
            found = lodestone.proposals(env)
            off = np.concatenate(moves)[:, [0, 5]] - found["moves"][[0, 5], HOLD]
            return off / found["noise"][[0, 5], HOLD][:, None]

        first, again, other = drawn(1, 400), drawn(1, 400), drawn(2, 400)
        np.testing.assert_array_equal(first, again)
        self.assertFalse((first == other).any())
        # 4,800 draws: three standard errors are 0.04 and 0.03.
        self.assertLess(abs(first.mean()), 0.05)
        self.assertLess(abs(first.std() - 1.0), 0.04)

    def test_what_is_not_offered_moves_nothing(self) -> None:
        env = lodestone.AssemblyEnv(blueprint="2_000", action="proposals", mask="blueprint")
        env.reset(seed=1)
        a, b = members(env)
        masks = env.action_masks().reshape(2, 16, 33)
        np.testing.assert_array_equal(masks[0], masks[1])
        np.testing.assert_array_equal(np.flatnonzero(masks[0].any(axis=-1)), [a, b])
        self.assertEqual(masks[0].sum(), 4)
        outside = next(block for block in range(16) if block not in (a, b))
        for wrong in (pick(a, JOIN + a), pick(a, DETACH + b), pick(outside, HOLD)):
            choices, moves = env.batch.to_native(np.array([wrong, pick(b, HOLD)]), "action")
            self.assertEqual(choices.tolist(), [[wrong // 33, b]])
            self.assertEqual(np.flatnonzero(moves[0].any(axis=-1)).tolist(), [b])

    def test_what_does_not_fit_is_named(self) -> None:
        env = lodestone.AssemblyEnv(blueprint="2_000", action="proposals")
        env.reset(seed=1)
        for agent in (lodestone.Expert(), lodestone.Policy.pretrained()):
            with self.assertRaisesRegex(ValueError, "env: only picks among proposals act here"):
                agent.act(env)
        with self.assertRaisesRegex(ValueError, r"action_masks\(\) is for the action 'proposals'"):
            lodestone.AssemblyEnv(blueprint="2_000").action_masks()
        with self.assertRaisesRegex(ValueError, "action is 'proposals': expected native or flat"):
            parallel_env(blueprint="2_000", action="proposals")


class Gymnasium(unittest.TestCase):
    SHORT = {"blueprint": ["2_000", "3_000"], "settings": {"episode_steps": 5}, "action": "proposals"}

    def test_its_judge_finds_nothing(self) -> None:
        os.environ["SDL_VIDEODRIVER"] = "dummy"
        for form in ({}, {"settings": {"n_grippers": 1}, "mask": "blueprint"}):
            env = gymnasium.make(ID, blueprint="2_000", action="proposals", **form)
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                check_env(env.unwrapped)

    def test_a_batch_gives_what_single_environments_give(self) -> None:
        """Noise included: worlds that start an episode instead of acting draw none."""
        for mode in AutoresetMode:
            envs = gymnasium.make_vec(ID, num_envs=4, autoreset_mode=mode, num_threads=2, **self.SHORT)
            singles = [lodestone.AssemblyEnv(**self.SHORT) for _ in range(4)]
            sync = SyncVectorEnv([lambda env=env: env for env in singles], autoreset_mode=mode)
            random = np.random.default_rng(2)
            for one in (envs, sync):
                one.reset(seed=3)
            n_ended = 0
            for _ in range(17):
                masks = envs.action_masks()
                np.testing.assert_array_equal(masks, [env.action_masks() for env in singles])
                drawn = offered_picks(masks, random)
                ours, theirs = envs.step(drawn), sync.step(drawn)
                self.assertTrue(data_equivalence(ours[:4], theirs[:4], exact=True), mode)
                ended = ours[2] | ours[3]
                n_ended += ended.sum()
                if mode == AutoresetMode.DISABLED and ended.any():
                    for one in (envs, sync):
                        one.reset(options={"reset_mask": ended.copy()})
            self.assertGreaterEqual(n_ended, 8)

    def test_copies_and_pickles_draw_the_same_noise(self) -> None:
        def play(envs: Any) -> list[Any]:
            random, seen = np.random.default_rng(7), []
            for _ in range(7):
                seen.append(copy.deepcopy(envs.step(offered_picks(envs.action_masks(), random))[:4]))
            return seen

        envs = lodestone.AssemblyVectorEnv(3, **self.SHORT)
        envs.reset(seed=4)
        for _ in range(3):
            made = [envs, copy.deepcopy(envs), pickle.loads(pickle.dumps(envs))]
            last, *others = [play(one) for one in reversed(made)]
            for other in others:
                self.assertTrue(data_equivalence(last, other, exact=True))


class StableBaselines3(unittest.TestCase):
    WORLD = {"blueprint": "2_000", "action": "proposals", "mask": "blueprint"}

    def test_its_judge_finds_nothing(self) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            check_env_for_sb3(lodestone.AssemblyEnv(observation="flat", **self.WORLD))

    def test_ppo_with_masks_picks_what_is_offered(self) -> None:
        envs = AssemblyVecEnv(4, **self.WORLD)
        model = MaskablePPO("MlpPolicy", envs, n_steps=16, batch_size=32, n_epochs=1, seed=1, device="cpu")
        model.learn(128)
        envs.seed(5)
        seen = envs.reset()
        for _ in range(10):
            masks = get_action_masks(envs)
            self.assertEqual(masks.shape, (4, 2 * N_PICKS))
            drawn, _ = model.predict(seen, action_masks=masks)
            self.assertTrue(np.take_along_axis(masks.reshape(4, 2, N_PICKS), drawn[..., None], axis=-1).all())
            seen, *_ = envs.step(drawn)

    def test_a_single_environment_has_masks_behind_its_wrappers(self) -> None:
        env = gymnasium.make(ID, observation="flat", **self.WORLD)
        MaskablePPO("MlpPolicy", env, n_steps=16, batch_size=16, n_epochs=1, device="cpu").learn(32)

    def test_ppo_without_masks_runs(self) -> None:
        envs = AssemblyVecEnv(4, **self.WORLD)
        PPO("MlpPolicy", envs, n_steps=16, batch_size=32, n_epochs=1, device="cpu").learn(64)


if __name__ == "__main__":
    unittest.main()

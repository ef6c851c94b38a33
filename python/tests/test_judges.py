"""Tests the environments with PettingZoo's and Stable-Baselines3's checkers, and the agents in the package.

python -m unittest discover -s python/tests
"""

from __future__ import annotations

import contextlib
import io
import os
import unittest
import warnings

import golden
import gymnasium
import lodestone
import numpy as np
import torch
from lodestone.batch import flatten, unflatten
from lodestone.parallel import parallel_env
from lodestone.sb3 import AssemblyVecEnv
from pettingzoo.test import parallel_api_test, parallel_seed_test
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecMonitor

ID = "Lodestone/Assembly-v0"
FORMS = ({}, {"observation": "flat", "action": "flat"})


class PettingZoo(unittest.TestCase):
    def test_its_judges_find_nothing(self) -> None:
        for form in (*FORMS, {"settings": {"n_grippers": 1}}):
            with self.subTest(form), contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
                warnings.simplefilter("error")
                settings = {"episode_steps": 30, **form.get("settings", {})}
                parallel_api_test(parallel_env(blueprint="3_000", **{**form, "settings": settings}), num_cycles=100)
                parallel_seed_test(lambda form=form: parallel_env(blueprint="train", **form), num_cycles=20)

    def test_each_gripper_sees_itself_first(self) -> None:
        env = parallel_env(blueprint="2_000")
        env.reset(seed=1)
        still = np.zeros(6, np.float32)
        choices = {"gripper_0": 3, "gripper_1": 12}
        seen, *_ = env.step({agent: {"choice": choice, "move": still} for agent, choice in choices.items()})
        for agent, choice in choices.items():
            self.assertIn(seen[agent], env.observation_space(agent))
            np.testing.assert_array_equal(np.flatnonzero(seen[agent]["nodes"][:, 1]), [choice])
            np.testing.assert_array_equal(np.flatnonzero(seen[agent]["globals"][9:25]), [choice])
            other = sum(choices.values()) - choice
            np.testing.assert_array_equal(np.flatnonzero(seen[agent]["nodes"][:, 2]), [other])
            np.testing.assert_array_equal(np.flatnonzero(seen[agent]["globals"][34:50]), [other])

    def test_flat_observations_have_the_order_of_all_others(self) -> None:
        env, flat = parallel_env(blueprint="2_000"), parallel_env(blueprint="2_000", observation="flat")
        seen, expected = flat.reset(seed=1)[0], env.reset(seed=1)[0]
        for agent, parts in expected.items():
            parts = [parts[name].ravel() for name in ("nodes", "edges", "globals")]
            np.testing.assert_array_equal(seen[agent], np.concatenate(parts))

    def test_it_shows_its_world(self) -> None:
        os.environ["SDL_VIDEODRIVER"] = "dummy"
        for mode, shown in (("rgb_array", (64, 96, 3)), ("human", None), (None, None)):
            env = parallel_env(blueprint="2_000", render_mode=mode, render_size=(96, 64))
            env.reset(seed=1)
            self.assertEqual(getattr(env.render(), "shape", None), shown)
            env.close()

    def test_what_is_wrong_is_named(self) -> None:
        with self.assertRaisesRegex(ValueError, "observation is 'pixels': expected features or flat"):
            parallel_env(observation="pixels")
        env = parallel_env(blueprint="2_000")
        env.reset(seed=1)
        with self.assertRaisesRegex(ValueError, "no action for agent gripper_1"):
            env.step({"gripper_0": {"choice": 0, "move": np.zeros(6, np.float32)}})
        with self.assertRaisesRegex(ValueError, "choice of gripper_0 is 16"):
            env.step({agent: {"choice": 16, "move": np.zeros(6, np.float32)} for agent in env.agents})
        for action, error in (
            ({"choice": 1.9, "move": np.zeros(6)}, "choice of gripper_0 is 1.9: expected a whole number from 0 to 15"),
            ({"choice": 1, "move": 0.3}, r"move of gripper_0 has shape \(\): expected \(6,\)"),
            ({"choice": 1}, "no move: expected a dictionary of choice and move"),
            (1, "action of gripper_0 is 1: expected a dictionary"),
        ):
            with self.subTest(action), self.assertRaisesRegex(ValueError, error):
                env.step(dict.fromkeys(env.agents, action))
        flat = parallel_env(blueprint="2_000", action="flat")
        flat.reset(seed=1)
        with self.assertRaisesRegex(ValueError, r"action of gripper_0 has shape \(\): expected \(22,\)"):
            flat.step(dict.fromkeys(flat.agents, 0.5))
        before = env.scene()["positions"]
        with self.assertRaisesRegex(ValueError, "option 'blueprnt' is unknown: expected blueprint or start"):
            env.reset(options={"blueprnt": "2_000"})
        np.testing.assert_array_equal(env.scene()["positions"], before)

    def test_the_expert_and_the_policy_build_with_it(self) -> None:
        for form in FORMS:
            env = parallel_env(blueprint="2_000", starts="near-goal", **form)
            for agent in (lodestone.Expert(), lodestone.Policy.pretrained()):
                env.reset(seed=2)
                while env.agents:
                    _, _, terminated, _, _ = env.step(agent.act(env))
                self.assertTrue(all(terminated.values()))


class Agents(unittest.TestCase):
    def test_both_build_in_every_form(self) -> None:
        for form in (*FORMS, {"features": "paper"}):
            envs = gymnasium.make_vec(ID, num_envs=8, blueprint=["2_000", "4_000"], **form)
            for agent in (lodestone.Expert(), lodestone.Policy.pretrained()):
                with self.subTest(form=form, agent=type(agent).__name__):
                    _, built = envs.reset(seed=5), np.zeros(8, np.bool_)
                    for _ in range(100):
                        built |= envs.step(agent.act(envs))[2]
                    self.assertGreaterEqual(built.sum(), 7)

    def test_one_world_and_a_batch_agree(self) -> None:
        policy = golden.native(golden.gaussian())
        env, envs = gymnasium.make(ID, blueprint="4_000"), gymnasium.make_vec(ID, num_envs=3, blueprint="4_000")
        one, many = env.reset(seed=6)[0], envs.reset(seed=5)[0]
        acted, batch = policy.act(env), policy.act(envs)
        np.testing.assert_array_equal(acted["choices"], batch["choices"][1])
        np.testing.assert_allclose(acted["moves"], batch["moves"][1], atol=1e-5)
        predicted, _ = policy.predict(one)
        np.testing.assert_array_equal(predicted["moves"], acted["moves"])
        self.assertIn(predicted, env.action_space)
        predicted, _ = policy.predict(many)
        np.testing.assert_array_equal(predicted["moves"], batch["moves"])
        flat = np.concatenate([many[name].reshape(3, -1) for name in ("nodes", "edges", "globals")], axis=1)
        predicted, _ = golden.native(golden.gaussian(), "flat").predict(flat)
        choices, moves = unflatten(predicted.reshape(3, 2, 22))
        np.testing.assert_array_equal(choices, batch["choices"])
        for gripper in range(2):
            chosen = (np.arange(3), choices[:, gripper])
            np.testing.assert_array_equal(moves[chosen], batch["moves"][chosen])
        self.assertEqual(policy.evaluate(many).shape, (3,))

    def test_samples_follow_the_seed(self) -> None:
        policy = golden.native(golden.gaussian())
        seen = gymnasium.make_vec(ID, num_envs=3, blueprint="4_000").reset(seed=1)[0]
        draws = []
        for seed in (1, 1, 2):
            policy.seed(seed)
            draws.append(policy.predict(seen, deterministic=False)[0]["moves"])
        np.testing.assert_array_equal(draws[0], draws[1])
        self.assertFalse(np.array_equal(draws[0], draws[2]))

    def test_what_does_not_fit_is_named(self) -> None:
        policy = golden.native(golden.gaussian())
        paper = gymnasium.make(ID, features="paper").reset(seed=1)[0]
        with self.assertRaisesRegex(ValueError, r"nodes has shape \(16, 3\): this policy expects \(1, 16, 10\)"):
            policy.predict(paper)
        one = gymnasium.make(ID, settings={"n_grippers": 1})
        one.reset(seed=1)
        with self.assertRaisesRegex(ValueError, "2 grippers cannot act with 1"):
            policy.act(one)
        with self.assertRaisesRegex(ValueError, "env is .*: expected an environment of lodestone"):
            policy.act(gymnasium.make("CartPole-v1"))
        with self.assertRaisesRegex(OSError, "cannot read /nowhere"):
            lodestone.Policy.load("/nowhere")
        with self.assertRaisesRegex(ValueError, r"test_judges.py: is damaged: it is no safetensors file: header"):
            lodestone.Policy.load(__file__)

    def test_a_mask_leaves_the_blocks_that_matter(self) -> None:
        env = lodestone.AssemblyEnv(blueprint="3_000", starts="prebuilt:2_000", action="flat", mask="blueprint")
        env.reset(seed=1)
        before = env.scene()
        matters = before["in_blueprint"].copy()
        matters[before["connections"]] = True
        self.assertGreater(matters.sum(), 2)
        for block in range(16):
            action = np.zeros(44, np.float32)
            action[[block, 22 + block]] = 1.0
            env.step(action)
            held = env.scene()["held"]
            self.assertTrue(matters[held].all())
            self.assertEqual((held == block).all(), matters[block])
        # The block that is taken in place of a masked one does not get its move.
        masked = int(np.flatnonzero(~matters)[0])
        choices, moves = np.array([[masked, masked]]), np.ones((1, 16, 6), np.float32)
        native = env.batch.to_native(env.batch.from_native(choices, moves))
        self.assertTrue(matters[native[0]].all())
        self.assertFalse(native[1].any())
        with self.assertRaisesRegex(ValueError, "mask 'blueprint' is for flat actions"):
            lodestone.AssemblyEnv(mask="blueprint")

    def test_flat_actions_go_there_and_back(self) -> None:
        choices = np.array([[3, 12], [5, 5]])
        moves = np.zeros((2, 16, 6), np.float32)
        moves[0, 3], moves[0, 12], moves[1, 5] = 0.5, -0.25, 1.0
        back = unflatten(flatten(choices, moves))
        np.testing.assert_array_equal(back[0], choices)
        np.testing.assert_array_equal(back[1], moves)
        # Both grippers chose block 5, so its move is the mean.
        flat = flatten(choices, moves)
        flat[1, 1, 16:] = 0.0
        np.testing.assert_array_equal(unflatten(flat)[1][1, 5], np.full(6, 0.5))


class StableBaselines3(unittest.TestCase):
    def test_its_judge_finds_nothing(self) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            check_env(lodestone.AssemblyEnv(blueprint="2_000", observation="flat", action="flat"))
            # The checker warns about matrices in dictionary observations.
            warnings.filterwarnings("ignore", message="Your observation (nodes|edges) has an unconventional shape")
            check_env(lodestone.AssemblyEnv(blueprint="2_000", action="flat"))

    def test_it_evaluates_our_policy(self) -> None:
        envs = AssemblyVecEnv(4, blueprint="2_000", starts="near-goal")
        envs.seed(1)
        policy = lodestone.Policy.pretrained()

        class OfWorlds:
            """The policy draws from proposals, which it makes from the worlds and not from the observations."""

            def predict(self, observation, state=None, episode_start=None, deterministic=True):
                return policy.act(envs, deterministic), state

        monitored = VecMonitor(envs)
        returns, lengths = evaluate_policy(OfWorlds(), monitored, n_eval_episodes=8, return_episode_rewards=True)
        self.assertGreater(np.median(returns), 1.0)
        self.assertLess(np.median(lengths), 30)

    def test_options_choose_the_next_goals(self) -> None:
        envs = AssemblyVecEnv(3, blueprint="2_000", starts="scattered")
        envs.set_options([{"blueprint": "3_000"}, {}, {"blueprint": "2_001"}])
        envs.reset()
        self.assertEqual([info["blueprint"] for info in envs.reset_infos], ["3_000", "2_000", "2_001"])
        envs.set_options({"blueprint": "3_000"})
        envs.reset()
        self.assertEqual([info["blueprint"] for info in envs.reset_infos], ["3_000"] * 3)
        envs.set_options([{"blueprint": "2_001"}, {}, {"blueprint": "3_000"}])
        seen = envs.reset()
        self.assertEqual([info["blueprint"] for info in envs.reset_infos], ["2_001", "2_000", "3_000"])
        self.assertTrue(np.isfinite(seen).all())
        # Options apply to one reset only.
        envs.reset()
        self.assertEqual([info["blueprint"] for info in envs.reset_infos], ["2_000"] * 3)

    def test_ppo_learns_a_start_next_to_the_goal(self) -> None:
        # Magnets that catch from afar and slow grippers: the default settings need ten times as many steps.
        settings = {
            "episode_steps": 20,
            "max_speed_mps": 1.0,
            "max_turn_radps": 2.0,
            "magnets": {"snap_gap_m": 0.045, "snap_angle_deg": 40},
        }
        near = {"blueprint": "2_000", "starts": "near-goal:1", "shuffle_blocks": False, "settings": settings}
        envs = VecMonitor(AssemblyVecEnv(32, observation="features", mask="blueprint", **near))
        self.addCleanup(torch.set_num_threads, torch.get_num_threads())
        torch.set_num_threads(1)
        model = PPO(
            "MultiInputPolicy",
            envs,
            seed=0,
            n_steps=32,
            batch_size=256,
            n_epochs=8,
            gamma=0.9,
            gae_lambda=0.9,
            learning_rate=2e-3,
            policy_kwargs={
                "features_extractor_class": NeededMoves,
                "net_arch": [64, 64],
                "log_std_init": -1.0,
            },
        )
        returns = Returns()
        model.learn(61_440, callback=returns)
        first, last = (np.mean(part) for part in (returns.seen[:500], returns.seen[-500:]))
        self.assertGreater(last, first + 0.3)


class NeededMoves(BaseFeaturesExtractor):
    """Extracts each block's needed moves, summed over its edges, and its height if it belongs to the blueprint."""

    def __init__(self, space: gymnasium.spaces.Dict) -> None:
        super().__init__(space, features_dim=16 * 13)
        receivers = [i for j in range(16) for i in range(16) if i != j]
        self.register_buffer("gather", torch.nn.functional.one_hot(torch.tensor(receivers), 16).T.float())

    def forward(self, seen: dict[str, torch.Tensor]) -> torch.Tensor:
        needed = self.gather @ seen["edges"][..., 24:36]
        heights = seen["nodes"][..., 0] * seen["nodes"][..., 6]
        return torch.cat([needed.flatten(1), heights], dim=1)


class Returns(BaseCallback):
    """Records the returns of all episodes."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[float] = []

    def _on_step(self) -> bool:
        self.seen.extend(info["episode"]["r"] for info in self.locals["infos"] if "episode" in info)
        return True


if __name__ == "__main__":
    unittest.main()

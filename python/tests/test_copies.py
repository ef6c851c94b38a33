"""Tests that copies and pickles of environments and policies go on bit for bit.

python -m unittest discover -s python/tests
"""

from __future__ import annotations

import copy
import os
import pickle
import subprocess
import sys
import tempfile
import unittest
from collections.abc import Callable
from pathlib import Path
from typing import Any

import golden
import gymnasium
import lodestone
import numpy as np
from gymnasium.error import ClosedEnvironmentError
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode
from lodestone.parallel import parallel_env
from lodestone.sb3 import AssemblyVecEnv

ID = "Lodestone/Assembly-v0"
CATALOG = Path(__file__).parents[2] / "blueprints/catalog"
# Episodes that end by success and by time, and that begin in every way.
WORLD: dict[str, Any] = {
    "blueprint": ["2_000", "3_000", "6_005"],
    "starts": {"near-goal": 2, "scattered": 1, "prebuilt": 1, "as-it-is": 3},
    "settings": {"episode_steps": 7, "randomization": {"friction": [0.5, 2]}},
}
FORMS = ({}, {"observation": "flat", "action": "flat", "mask": "blueprint"}, {"features": "paper"})
COPIES: tuple[Callable[[Any], Any], ...] = (copy.deepcopy, lambda made: pickle.loads(pickle.dumps(made)))


def plain(value: Any) -> Any:
    """Returns nested data with object arrays as lists, because Gymnasium's comparison does not look inside those."""
    if isinstance(value, dict):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)) or (isinstance(value, np.ndarray) and value.dtype == object):
        return [plain(entry) for entry in value]
    return value


class Copies(unittest.TestCase):
    def same(self, made: list[Any], play: Callable[[Any], Any]) -> None:
        """Plays with each; the copies come first, so that what they do to the original would be seen."""
        first, *others = [plain(play(one)) for one in reversed(made)]
        for other in others:
            self.assertTrue(data_equivalence(first, other, exact=True), f"{first} is not {other}")

    def branch(self, made: Any) -> list[Any]:
        return [made, *(make(made) for make in COPIES), *(make(make(made)) for make in COPIES)]

    def test_a_single_environment(self) -> None:
        def play(env: Any) -> list[Any]:
            seen: list[Any] = [env.action_space.sample()]
            for _ in range(9):
                action = lodestone.Expert().act(env) if len(seen) % 2 else env.action_space.sample()
                seen.append(env.step(action))
                if seen[-1][2] or seen[-1][3]:
                    seen.append(env.reset())
            return [*seen, env.unwrapped.scene(), env.render()]

        for form in FORMS:
            env = gymnasium.make(ID, render_mode="rgb_array", render_size=(48, 32), **{**WORLD, **form})
            env.action_space.seed(5)
            with self.subTest(form, at="before the first episode"):
                self.same(self.branch(env), lambda env: env.reset(seed=4))
            for at in range(12):
                with self.subTest(form, at=at):
                    self.same(self.branch(env), play)

    def test_after_a_divergence(self) -> None:
        env = lodestone.AssemblyEnv(blueprint="2_000", starts="as-it-is")
        env.reset(seed=1)
        env.step(env.action_space.sample())
        env.reset()
        env.step({"choices": np.array([0, 1]), "moves": np.full((16, 6), np.nan, np.float32)})
        self.same(self.branch(env), lambda env: [env.scene(), env.reset()])

    def test_a_batch(self) -> None:
        def play(envs: Any) -> list[Any]:
            seen: list[Any] = [envs.action_space.sample()]
            for _ in range(9):
                actions = lodestone.Expert().act(envs) if len(seen) % 2 else envs.action_space.sample()
                seen.append(copy.deepcopy(envs.step(actions)))
                ended = seen[-1][2] | seen[-1][3]
                if envs.metadata["autoreset_mode"] == AutoresetMode.DISABLED and ended.any():
                    seen.append(copy.deepcopy(envs.reset(options={"reset_mask": ended})))
            return [*seen, envs.render()]

        for mode in AutoresetMode:
            for form in (*FORMS, {"copy": False}):
                given = {**WORLD, **form, "num_threads": 2, "render_mode": "rgb_array", "render_size": (48, 32)}
                envs = lodestone.AssemblyVectorEnv(3, autoreset_mode=mode, **given)
                envs.action_space.seed(5)
                envs.reset(seed=4)
                for at in range(2):
                    with self.subTest(form, mode=mode, at=at):
                        self.same(self.branch(envs), play)

    def test_an_agent_for_each_gripper(self) -> None:
        def play(env: Any) -> list[Any]:
            seen: list[Any] = []
            for _ in range(9):
                seen.append(env.reset() if not env.agents else env.step(lodestone.Expert().act(env)))
                seen.append({agent: env.action_space(agent).sample() for agent in env.possible_agents})
            return [*seen, env.agents]

        for form in FORMS:
            env = parallel_env(**{**WORLD, **form})
            for agent in env.possible_agents:
                env.action_space(agent).seed(5)
            self.same(self.branch(env), lambda env: env.reset(seed=4))
            for at in range(3):
                with self.subTest(form, at=at):
                    self.same(self.branch(env), play)

    def test_stable_baselines(self) -> None:
        def play(envs: Any) -> list[Any]:
            return [envs.step(lodestone.Expert().act(envs)) for _ in range(9)]

        # Without a wrapper: those of Stable-Baselines3 cannot be copied.
        envs = AssemblyVecEnv(3, **WORLD)
        envs.seed(4)
        envs.set_options({"blueprint": "3_000"})
        self.same(self.branch(envs), lambda envs: envs.reset())
        for _ in range(2):
            self.same(self.branch(envs), play)
        self.same(self.branch(envs), lambda envs: envs.reset_infos)

    def test_a_policy_that_samples(self) -> None:
        envs = lodestone.AssemblyVectorEnv(5, blueprint="4_000")
        seen = envs.reset(seed=1)[0]
        few = {name: values[:2] for name, values in seen.items()}
        for action in ("native", "flat"):
            policy = golden.native(golden.gaussian(), action)
            policy.seed(7)
            for n, observation in ((2, few), (5, seen), (2, few)):
                with self.subTest(action, n=n):
                    made = self.branch(policy)
                    # Rows that the policy has seen go on, and the others begin as they would have.
                    self.same(made, lambda one: one.predict(seen, deterministic=False)[0])
                    self.same(made, lambda one, o=observation: [one.predict(o, deterministic=False)[0], one.version])
                    self.same(made, lambda one: one.act(envs, deterministic=False))

    def test_a_pickle_needs_no_file_and_no_ancestor(self) -> None:
        program = """
import pickle, sys
env, policy = pickle.load(sys.stdin.buffer)
seen = [env.step(policy.act(env, deterministic=False)) for _ in range(20)]
pickle.dump((seen, env.scene(), env.reset()), sys.stdout.buffer)
"""
        with tempfile.TemporaryDirectory() as folder:
            own = Path(folder, "mine.toml")
            own.write_text((CATALOG / "4_000.toml").read_text().replace('"4_000"', '"mine_4_000"'))
            env = lodestone.AssemblyEnv(blueprint=[own, "2_000"], starts="prebuilt:mine_4_000")
        policy = lodestone.Policy.pretrained()
        env.reset(seed=3, options={"blueprint": "mine_4_000", "start": "near-goal:2"})
        for _ in range(10):
            env.step(policy.act(env, deterministic=False))
        told = pickle.dumps((env, policy))
        done = subprocess.run([sys.executable, "-c", program], input=told, stdout=subprocess.PIPE, check=True)
        ours = [env.step(policy.act(env, deterministic=False)) for _ in range(20)]
        ours = (ours, env.scene(), env.reset())
        self.assertTrue(data_equivalence(plain(ours), plain(pickle.loads(done.stdout)), exact=True))

    def test_what_cannot_be_replayed_is_told(self) -> None:
        batch = lodestone.AssemblyEnv(blueprint="2_000").batch
        out, one = batch.empty(), np.ones(1, np.bool_)
        batch.reset(one, [1], {"start": "scattered"}, out)
        make, arguments, states = batch.worlds.__reduce__()
        seed, stream, position, episodes, last, noise = states[0]
        lost = episodes[0][0].replace("2_000", "nowhere_2_999")
        for state, words in (
            ((seed, stream, position, episodes, bytes(len(last)), noise), "comes out differently"),
            ((seed, stream, position, [], last, noise), "comes out differently"),
            ((seed[1:], stream, position, episodes, last, noise), "damaged"),
            ((seed, stream, position, [(episodes[0][0], bytes(3), None)], last, noise), "damaged"),
            ((seed, stream, position, [(episodes[0][0], bytes([16] * 50), None)], last, noise), "damaged"),
            ((seed, stream, position, [(*episodes[0][:2], '{"poses": [], "connections": []}')], last, noise), "damaged"),
            ((seed, stream, position, [(lost, *episodes[0][1:])], last, noise), "an episode cannot start"),
        ):
            with self.subTest(words), self.assertRaisesRegex(ValueError, f"world 0 cannot be restored: .*{words}"):
                make(*arguments).__setstate__([state])
        with self.assertRaisesRegex(ValueError, "0 states for 1 worlds"):
            make(*arguments).__setstate__([])
        # A start as it is owes everything to what was before.
        for _ in range(20_000):
            batch.reset(one, [None], {"start": "as-it-is"}, out)
        with self.assertRaisesRegex(ValueError, "world 0 cannot be pickled: .* more than 20000 steps"):
            pickle.dumps(batch)
        self.same([batch, copy.deepcopy(batch)], lambda batch: batch.worlds.scene(0))
        batch.reset(one, [None], {"start": "scattered"}, out)
        self.same(self.branch(batch), lambda batch: batch.worlds.scene(0))

    def test_a_copy_has_a_window_of_its_own(self) -> None:
        os.environ["SDL_VIDEODRIVER"] = "dummy"
        env = lodestone.AssemblyEnv(blueprint="2_000", render_mode="human")
        env.reset(seed=1)
        others = [parallel_env(blueprint="2_000", render_mode="human"), *(make(env) for make in COPIES)]
        others[0].reset(seed=1)
        others += [make(others[0]) for make in COPIES]
        env.close()
        for other in others:
            other.step(lodestone.Expert().act(other))
            other.close()

    def test_a_copy_of_a_closed_environment_is_closed(self) -> None:
        makers = (lodestone.AssemblyEnv, lambda **world: lodestone.AssemblyVectorEnv(2, **world), parallel_env)
        for env in [make(blueprint="2_000") for make in (*makers, lambda **world: AssemblyVecEnv(2, **world))]:
            env.close()
            for made in COPIES:
                with self.assertRaises(ClosedEnvironmentError):
                    made(env).reset()


if __name__ == "__main__":
    unittest.main()

"""Tests the Gymnasium environments with Gymnasium's checkers, and the native batch against `SyncVectorEnv`.

python -m unittest discover -s python/tests
"""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
import unittest
import warnings
from copy import deepcopy
from pathlib import Path
from typing import Any
from unittest import mock

import gymnasium
import lodestone
import numpy as np
from gymnasium.error import DependencyNotInstalled
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.utils.env_match import check_environments_match
from gymnasium.vector import AutoresetMode, SyncVectorEnv

ID = "Lodestone/Assembly-v0"
# Short episodes, so that both success and the time limit occur.
SHORT = {
    "blueprint": ["2_000", "3_000"],
    "starts": {"near-goal": 0.5, "scattered": 0.5},
    "settings": {"episode_steps": 5},
}
FORMS = ({}, {"observation": "flat", "action": "flat"}, {"features": "paper", "settings": {"n_grippers": 1}})
CATALOG = Path(__file__).parents[2] / "blueprints/catalog"
# The structure of 4_000 under another name.
COPY = (CATALOG / "4_000.toml").read_text().replace('"4_000"', '"mine_4_000"')

# Two structures under one name.
TWINS = [(CATALOG / f"{name}.toml").read_text().replace(f'"{name}"', '"mine"') for name in ("3_000", "4_000")]
HIDING = (CATALOG / "3_001.toml").read_text().replace('"3_001"', '"3_000"')


class SingleEnvironment(unittest.TestCase):
    def test_gymnasium_finds_nothing(self) -> None:
        os.environ["SDL_VIDEODRIVER"] = "dummy"
        for form in FORMS:
            env = gymnasium.make(ID, blueprint="2_000", **form)
            with self.subTest(form), warnings.catch_warnings():
                warnings.simplefilter("error")
                check_env(env.unwrapped)

    def test_seeds_determine_episodes(self) -> None:
        mix = {"scattered": 1, "prebuilt": 1, "near-goal:1-3": 1}
        envs = [gymnasium.make(ID, starts=mix, disable_env_checker=True) for _ in range(2)]
        check_environments_match(*envs, num_steps=30, seed=7)
        drawn = []
        for _ in range(20):
            infos = [env.reset()[1] for env in envs]
            self.assertEqual(infos[0], infos[1])
            drawn.append((infos[0]["blueprint"], infos[0]["start"].split(":")[0]))
        self.assertEqual({start for _, start in drawn}, {"scattered", "prebuilt", "near-goal"})
        self.assertGreater(len({blueprint for blueprint, _ in drawn}), 10)

    def test_an_episode_can_be_asked_for(self) -> None:
        env = gymnasium.make(ID, blueprint="2_000")
        self.assertEqual(env.reset(seed=1)[1], {"blueprint": "2_000", "start": "scattered"})
        options = {"blueprint": "6_005", "start": "near-goal:2"}
        self.assertEqual(env.reset(options=options)[1], {"blueprint": "6_005", "start": "near-goal:2"})
        before = env.unwrapped.scene()["positions"]
        env.reset(options={"start": "as-it-is"})
        np.testing.assert_array_equal(env.unwrapped.scene()["positions"], before)

    def test_as_it_is_begins_scattered_where_nothing_is_left(self) -> None:
        env = lodestone.AssemblyEnv(blueprint="2_000", starts="as-it-is")
        self.assertEqual(env.reset(seed=1)[1]["start"], "scattered")
        before = env.scene()["positions"]
        self.assertEqual(env.reset()[1]["start"], "as-it-is")
        np.testing.assert_array_equal(env.scene()["positions"], before)
        env.step({"choices": np.array([0, 1]), "moves": np.full((16, 6), np.nan, np.float32)})
        self.assertEqual(env.reset()[1]["start"], "scattered")
        # Who asks for it is told.
        with self.assertRaisesRegex(ValueError, "no previous state"):
            lodestone.AssemblyEnv(blueprint="2_000").reset(seed=1, options={"start": "as-it-is"})

    def test_blueprints_come_from_files_and_splits(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            own = Path(folder, "mine.toml")
            own.write_text(COPY)
            self.assertEqual(lodestone.blueprints([own, "2_000"]), {"mine_4_000": 4, "2_000": 2})
            self.assertEqual(lodestone.blueprints(own.read_text()), {"mine_4_000": 4})
            with self.assertRaisesRegex(ValueError, "the text of a blueprint"):
                lodestone.blueprints("blocks = [\n")
            env = gymnasium.make(ID, blueprint=own)
            self.assertEqual(env.reset(seed=1)[1]["blueprint"], "mine_4_000")
        self.assertEqual(len(lodestone.blueprints("train")), 142)
        self.assertEqual(len(lodestone.blueprints("validation")), 34)

    def test_splits_and_ids_come_before_folders(self) -> None:
        mine = {"mine_4_000": 4}
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            for name in ("train", "2_000", "others"):
                Path(name).mkdir()
                Path(name, "mine.toml").write_text(COPY)
            Path("3_000.toml").write_text(COPY)
            Path("noted").write_text(COPY)
            self.assertEqual(len(lodestone.blueprints("train")), 142)
            self.assertEqual(lodestone.blueprints("2_000"), {"2_000": 2})
            for path in ("./train", "2_000/", Path("train"), Path("2_000"), "others", "3_000.toml", "noted"):
                with self.subTest(path):
                    self.assertEqual(lodestone.blueprints(path), mine)

    def test_a_block_that_could_lie_in_several_ways_is_told(self) -> None:
        low = '{ name = "low", type = "3x1x1", at = [0, 0, 0], size = [3, 1, 1] }'
        top = '{ name = "top", type = "3x1x1", at = [0, 0, 1] }'
        text = f'id = "bars"\nblocks = [\n{low},\n{top},\n]\n'
        words = r'block "top" is turned "\+x \+y".*; `axes` in the file chooses another'
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "bars.toml")
            file.write_text(text)
            for own, name in ((text, "the text of a blueprint"), (file, str(file)), (folder, str(file))):
                makers = (lodestone.blueprints, lambda own: lodestone.AssemblyEnv(blueprint=own))
                for make in makers:
                    with self.assertWarnsRegex(UserWarning, f"^{name}: {words}$") as warned:
                        make(own)
                    self.assertEqual((len(warned.warnings), warned.filename), (1, __file__))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            lodestone.blueprints(text.replace("at = [0, 0, 1]", 'at = [0, 0, 1], axes = "+x +y"'))
            with self.assertRaises(UserWarning):
                lodestone.AssemblyEnv(blueprint=text)

    def test_blueprints_of_ones_own_stand_at_the_start(self) -> None:
        env = lodestone.AssemblyEnv(blueprint=["2_000", COPY], starts="prebuilt:mine_4_000")
        goal = {"blueprint": "2_000", "start": "prebuilt:mine_4_000"}
        self.assertEqual(env.reset(seed=1, options={"blueprint": "2_000"})[1], goal)
        self.assertGreaterEqual(len(env.scene()["connections"]), 3)
        # The copy replaces 4_000, which is then never drawn.
        envs = gymnasium.make_vec(ID, num_envs=8, blueprint=COPY, starts="prebuilt")
        for _ in range(100):
            self.assertNotIn("prebuilt:4_000", envs.reset()[1]["start"])
        # With copies of all training blueprints, none is left to draw.
        texts = {name: (CATALOG / f"{name}.toml").read_text() for name in lodestone.blueprints("train")}
        copies = [text.replace(f'"{name}"', f'"mine_{name}"') for name, text in texts.items()]
        env = lodestone.AssemblyEnv(blueprint=copies, starts="prebuilt")
        self.assertEqual(env.reset(seed=1)[1]["start"], "scattered")

    def test_what_is_wrong_is_named(self) -> None:
        for wrong, words in [
            ({"blueprint": "nowhere"}, '"nowhere" is unknown'),
            ({"blueprint": []}, "blueprint is []: expected at least one"),
            ({"blueprint": "/nowhere.toml"}, "blueprint: cannot read /nowhere.toml"),
            ({"starts": "upside-down"}, '"upside-down" is unknown'),
            ({"starts": "near-goal:16"}, '"near-goal:16" is unknown'),
            ({"starts": {"scattered": -1}}, 'start "scattered" is -1'),
            ({"starts": {"scattered": 0}}, "positive weight"),
            ({"settings": {"physics": {"friction": 9}}}, "settings.physics.friction = 9: expected 0..=2"),
            ({"settings": {"fysics": {}}}, "unknown field `fysics`"),
            ({"settings": {"episode_steps": {5}}}, "settings.episode_steps is {5}"),
            ({"settings": "/nowhere.toml"}, "settings: cannot read /nowhere.toml: No such file"),
            ({"settings": CATALOG}, f"settings: cannot read {CATALOG}: Is a directory"),
            ({"settings": __file__}, f"settings: {__file__} is not TOML"),
            ({"starts": "prebuilt:train"}, '"train" is unknown: expected one id, such as 4_000'),
            ({"blueprint": ["4_000", COPY]}, "blueprint 4_000 is the same structure as another one"),
            ({"blueprint": TWINS}, "two different blueprints are called mine:"),
            ({"blueprint": HIDING}, "two different blueprints are called 3_000:"),
            ({"blueprint": ["3_000", HIDING]}, "two different blueprints are called 3_000:"),
            ({"num_threads": -1}, "num_threads is -1: expected a whole number from 1 to 1024"),
            ({"features": "none"}, "features is 'none': expected all or paper"),
            ({"features": {"up": True}}, "unknown field `up`"),
            ({"observation": "pixels"}, "observation is 'pixels': expected features or flat"),
            ({"action": "joints"}, "action is 'joints': expected native, flat or proposals"),
            ({"render_mode": "ansi"}, "render_mode is 'ansi': expected None, human or rgb_array"),
        ]:
            with self.subTest(wrong), self.assertRaises(ValueError) as raised:
                lodestone.AssemblyEnv(**wrong)
            self.assertIn(words, str(raised.exception))

    def test_a_wrong_call_leaves_the_world_as_it_was(self) -> None:
        env = lodestone.AssemblyEnv(blueprint="2_000")
        idle = {"choices": np.zeros(2, np.int64), "moves": np.zeros((16, 6), np.float32)}
        with self.assertRaisesRegex(ValueError, "world 0 has no episode yet"):
            env.step(idle)
        env.reset(seed=1)
        before = env.scene()["positions"]
        with self.assertRaisesRegex(ValueError, r"choices\[0, 1\] is 16: expected a block from 0 to 15"):
            env.step({**idle, "choices": np.array([0, 16])})
        with self.assertRaisesRegex(ValueError, r"action: moves has shape \(16, 5\): expected \(16, 6\)"):
            env.step({**idle, "moves": np.zeros((16, 5), np.float32)})
        with self.assertRaisesRegex(ValueError, "choices has the type float64: expected whole numbers"):
            env.step({**idle, "choices": np.array([0.0, 1.9])})
        with self.assertRaisesRegex(ValueError, "no choices: expected a dictionary of choices and moves"):
            env.step({"choice": 1, "moves": idle["moves"]})
        with self.assertRaisesRegex(ValueError, "options is 3: expected a dictionary"):
            env.reset(options=3)
        with self.assertRaisesRegex(ValueError, "option 'blueprnt' is unknown"):
            env.reset(options={"blueprnt": "2_000"})
        with self.assertRaisesRegex(ValueError, '"nowhere" is unknown'):
            env.reset(options={"blueprint": "nowhere"})
        for options in ({"blueprint": "train"}, {"start": "prebuilt:train"}):
            with self.assertRaises(ValueError) as raised:
                env.reset(options=options)
            self.assertIn('"train" is unknown: expected one id', str(raised.exception))
            self.assertNotIn("split", str(raised.exception))
        with self.assertRaisesRegex(ValueError, "option 'start' is 1: expected a text"):
            env.reset(options={"start": 1})
        np.testing.assert_array_equal(env.scene()["positions"], before)

    def test_settings_come_from_a_configuration_file(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "config.toml")
            for base in ("", 'base = "none"\n'):
                file.write_text(f"{base}seed = 3\n[environment]\nepisode_steps = 7\n")
                self.assertEqual(lodestone.AssemblyEnv(settings=file).batch.worlds.episode_steps, 7)
            file.write_text('base = "laptop"\n[environment]\nepisode_steps = 7\n')
            with self.assertRaisesRegex(ValueError, "config.toml has base = 'laptop', a preset that this package"):
                lodestone.AssemblyEnv(settings=str(file))

    def test_a_world_that_diverges_is_truncated(self) -> None:
        env = lodestone.AssemblyEnv(blueprint="2_000")
        env.reset(seed=1)
        moves = np.full((16, 6), np.nan, np.float32)
        seen, reward, terminated, truncated, info = env.step({"choices": np.array([0, 1]), "moves": moves})
        self.assertEqual((reward, terminated, truncated, info["diverged"]), (0.0, False, True, True))
        self.assertIn(seen, env.observation_space)
        env.reset()
        self.assertFalse(env.step(env.action_space.sample())[4]["diverged"])

    def test_pictures_show_what_moves(self) -> None:
        env = gymnasium.make(ID, blueprint="4_000", render_mode="rgb_array", render_size=(320, 200))
        env.reset(seed=1)
        first = env.render()
        self.assertEqual((first.shape, first.dtype), ((200, 320, 3), np.uint8))
        for _ in range(5):
            env.step(lodestone.Expert().act(env))
        changed = (env.render() != first).any(axis=-1)
        self.assertGreater(changed.sum(), 50)
        # The goal in the upper right corner does not change.
        self.assertFalse(changed[:58, -58:].any())

    def test_a_window_without_pygame_says_what_to_install(self) -> None:
        env = lodestone.AssemblyEnv(blueprint="2_000", render_mode="human")
        without = mock.patch.dict(sys.modules, {"pygame": None})
        with without, self.assertRaisesRegex(DependencyNotInstalled, "pip install pygame-ce"):
            env.reset(seed=1)


class VectorEnvironment(unittest.TestCase):
    def test_it_gives_what_single_environments_give(self) -> None:
        for form in FORMS:
            settings = {**SHORT["settings"], **form.get("settings", {})}
            world = {**SHORT, **form, "settings": settings}
            for mode in AutoresetMode:
                with self.subTest(form=form, mode=mode):
                    self._compare(mode, world)

    def _compare(self, mode: AutoresetMode, world: dict[str, Any]) -> None:
        n = 5
        native = gymnasium.make_vec(ID, num_envs=n, autoreset_mode=mode, num_threads=2, **world)
        self.assertIs(native.metadata["autoreset_mode"], mode)
        sync = SyncVectorEnv([lambda: lodestone.AssemblyEnv(**world) for _ in range(n)], autoreset_mode=mode)
        self.assertEqual(native.observation_space, sync.observation_space)
        self.assertEqual(native.action_space, sync.action_space)
        self._equal(native.reset(seed=3), sync.reset(seed=3))
        native.action_space.seed(3)
        n_ended = 0
        for step in range(17):
            actions = native.action_space.sample()
            ours, theirs = native.step(actions), sync.step(actions)
            self._equal(ours, theirs)
            ended = ours[2] | ours[3]
            n_ended += ended.sum()
            self.assertIn(ours[0], native.observation_space)
            if mode == AutoresetMode.DISABLED and ended.any():
                with self.assertRaisesRegex(ValueError, "has ended"):
                    native.step(actions)
                seeds = [step] * n if step % 2 else None
                self._equal(
                    native.reset(seed=seeds, options={"reset_mask": ended}),
                    sync.reset(seed=seeds, options={"reset_mask": ended.copy()}),
                )
        self.assertGreaterEqual(n_ended, 2 * n)

    def _equal(self, ours: tuple[Any, ...], theirs: tuple[Any, ...]) -> None:
        for mine, other in zip(ours[:-1], theirs[:-1], strict=True):
            self.assertTrue(data_equivalence(mine, other, exact=True))
        self.assertTrue(_same(ours[-1], theirs[-1]), f"{ours[-1]} is not {theirs[-1]}")

    def test_threads_change_nothing(self) -> None:
        runs = []
        for num_threads in (1, 3):
            envs = gymnasium.make_vec(ID, num_envs=7, num_threads=num_threads, blueprint="train")
            envs.reset(seed=11)
            for _ in range(20):
                seen = envs.step(lodestone.Expert().act(envs))
            runs.append(seen)
        self.assertTrue(data_equivalence(runs[0], runs[1], exact=True))

    def test_arrays_are_reused_only_if_asked(self) -> None:
        for copy in (True, False):
            envs = gymnasium.make_vec(ID, num_envs=2, copy=copy, blueprint="2_000")
            first, _ = envs.reset(seed=1)
            kept = first["nodes"].copy()
            second = envs.step(envs.action_space.sample())[0]
            self.assertEqual(second["nodes"] is first["nodes"], not copy)
            self.assertEqual(np.array_equal(first["nodes"], kept), copy)

    def test_what_a_caller_does_to_an_observation_stays_with_the_caller(self) -> None:
        for form in ("features", "flat"):
            envs = gymnasium.make_vec(
                ID, num_envs=2, blueprint="3_000", observation=form, autoreset_mode=AutoresetMode.DISABLED
            )
            first, _ = envs.reset(seed=1)
            policy = lodestone.Policy.pretrained()
            before, kept = policy.act(envs), deepcopy(first)
            for array in first.values() if isinstance(first, dict) else [first]:
                array /= 256
            self.assertTrue(data_equivalence(policy.act(envs), before, exact=True))
            mask = np.array([True, False])
            again, _ = envs.reset(seed=[1, None], options={"reset_mask": mask})
            self.assertTrue(data_equivalence(again, kept, exact=True))

    def test_wrappers_of_gymnasium_work(self) -> None:
        envs = gymnasium.make_vec(ID, num_envs=3, **SHORT)
        envs = gymnasium.wrappers.vector.RecordEpisodeStatistics(envs)
        envs.reset(seed=1)
        for _ in range(12):
            infos = envs.step(envs.action_space.sample())[4]
            if "episode" in infos:
                self.assertLessEqual(infos["episode"]["l"].max(), 5)
        self.assertGreaterEqual(envs.episode_count, 6)

    def test_pictures_of_all_worlds(self) -> None:
        envs = gymnasium.make_vec(ID, num_envs=2, render_mode="rgb_array", render_size=(64, 48))
        envs.reset(seed=1)
        self.assertEqual([picture.shape for picture in envs.render()], [(48, 64, 3)] * 2)
        with self.assertRaisesRegex(ValueError, "render_mode is 'human': expected None or rgb_array"):
            gymnasium.make_vec(ID, num_envs=2, render_mode="human")


def _same(ours: Any, theirs: Any) -> bool:
    """Compares infos. Gymnasium's comparison does not look inside object arrays."""
    if isinstance(ours, dict):
        return (
            isinstance(theirs, dict) and ours.keys() == theirs.keys() and all(_same(ours[k], theirs[k]) for k in ours)
        )
    ours, theirs = np.asarray(ours), np.asarray(theirs)
    if ours.dtype == object:
        return len(ours) == len(theirs) and all(
            _same(a, b) if isinstance(a, (dict, np.ndarray)) else a == b for a, b in zip(ours, theirs, strict=True)
        )
    return ours.dtype == theirs.dtype and np.array_equal(ours, theirs)


if __name__ == "__main__":
    unittest.main()

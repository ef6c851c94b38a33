"""Tests what `lodestone.record` writes: reads it with Minari, and replays every episode in the recovered environment.

python -m unittest discover -s python/tests
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import gymnasium
import lodestone
import minari
import numpy as np
from gymnasium.error import DependencyNotInstalled
from gymnasium.utils.env_checker import data_equivalence
from lodestone.batch import row_of
from lodestone.record import record
from minari import MinariDataset

ID = "Lodestone/Assembly-v0"
CATALOG = Path(__file__).parents[2] / "blueprints/catalog"
COMMAND = (sys.executable, "-m", "lodestone.record")
RANDOM = SimpleNamespace(act=lambda env: env.action_space.sample())


def setUpModule() -> None:
    # Shells have what they start in the background ignore it, and so would what is started here.
    signal.signal(signal.SIGINT, signal.default_int_handler)


class Recording(unittest.TestCase):
    def setUp(self) -> None:
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)
        os.environ["MINARI_DATASETS_PATH"] = folder.name

    def command(self, *args: str) -> str:
        done = subprocess.run([*COMMAND, *args], check=False, capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done.stdout

    def test_a_learner_finds_the_spaces_of_the_environment(self) -> None:
        said = self.command("--blueprint", "2_000", "--episodes", "2")
        self.assertRegex(said, r"^lodestone/expert-v0: 2 episodes, \d+ steps, 2 built\n$")
        dataset, env = minari.load_dataset("lodestone/expert-v0"), gymnasium.make(ID, blueprint="2_000")
        self.assertEqual(dataset.observation_space, env.observation_space)
        self.assertEqual(dataset.action_space, env.action_space)
        for episode in dataset:
            for row in range(len(episode)):
                self.assertIn(row_of(episode.observations, row), env.observation_space)
                self.assertIn(row_of(episode.actions, row), env.action_space)
        listed = minari.list_local_datasets()
        self.assertEqual(list(listed), ["lodestone/expert-v0"])
        self.assertEqual(listed["lodestone/expert-v0"]["algorithm_name"], "expert")
        self.assertEqual(dataset.storage.metadata["lodestone"]["seed"], 0)

    def test_the_expert_is_seen_to_do_the_same_again(self) -> None:
        starts = {"scattered": 0.5, "prebuilt": 0.5}
        env = gymnasium.make(ID, blueprint=["2_000", "4_001"], starts=starts)
        dataset = record(env, lodestone.Expert(), "expert-v0", episodes=4, seed=7, code_permalink="https://x.example")
        self.assertEqual(dataset.storage.metadata["code_permalink"], "https://x.example")
        told = self._play_again(dataset)
        self.assertEqual([one["seed"] for one in told], list(range(7, 15)))
        self.assertEqual([one["options"]["blueprint"] for one in told], ["2_000", "4_001"] * 4)
        self.assertEqual({one["start"].split(":")[0] for one in told}, {"scattered", "prebuilt"})

    def test_the_policy_is_seen_to_do_the_same_again_without_its_files(self) -> None:
        own, settings = self.folder / "mine.toml", self.folder / "config.toml"
        own.write_text((CATALOG / "3_000.toml").read_text().replace('"3_000"', '"mine_3_000"'))
        settings.write_text("environment.episode_steps = 20\nenvironment.physics.friction = 0.5\n")
        args = ("--agent", "pretrained", "--blueprint", str(own), "--settings", str(settings), "--episodes", "2")
        for name, sampled in (("lodestone/pretrained-v0", []), ("lodestone/pretrained-sampled-v0", ["--sampled"])):
            self.command(*args, *sampled)
            origin = minari.load_dataset(name).storage.metadata["lodestone"]
            self.assertEqual(origin["weights_version"], lodestone.Policy.pretrained().version)
            self.assertEqual(origin["deterministic"], not sampled)
        own.unlink()
        settings.unlink()
        for name in ("lodestone/pretrained-v0", "lodestone/pretrained-sampled-v0"):
            dataset = minari.load_dataset(name)
            self._play_again(dataset)
            self.assertEqual({name for episode in dataset for name in episode.infos["blueprint"]}, {"mine_3_000"})

    def test_every_form_of_observations_and_actions_is_recorded(self) -> None:
        forms: tuple[dict[str, Any], ...] = (
            {"observation": "flat", "action": "flat"},
            {"action": "proposals", "mask": "blueprint"},
            {"features": "paper", "settings": {"n_grippers": 1}},
        )
        for number, form in enumerate(forms):
            with self.subTest(form):
                env = gymnasium.make(ID, blueprint="2_000", **form)
                env.action_space.seed(1)
                self._play_again(record(env, RANDOM, f"form-v{number}", episodes=1))

    def test_an_interrupted_recording_has_whole_episodes(self) -> None:
        args = ("--blueprint", "2_000", "--episodes", "100000", "--name", "short-v0")
        recording = subprocess.Popen([*COMMAND, *args], stderr=subprocess.PIPE, text=True)
        while not (self.folder / "short-v0/data/3").exists():
            self.assertIsNone(recording.poll())
            time.sleep(0.01)
        recording.send_signal(signal.SIGINT)
        _, said = recording.communicate()
        self.assertEqual(
            (recording.returncode, said), (130, "interrupted; short-v0 holds the episodes recorded so far\n")
        )
        told = self._play_again(minari.load_dataset("short-v0"))
        self.assertGreaterEqual(len(told), 3)

    def test_an_interrupt_waits_until_an_episode_is_written(self) -> None:
        write = MinariDataset.update_dataset_from_buffer

        def interrupted(dataset: MinariDataset, episodes: Any) -> None:
            signal.raise_signal(signal.SIGINT)
            write(dataset, episodes)

        env = gymnasium.make(ID, blueprint="2_000")
        with mock.patch.object(MinariDataset, "update_dataset_from_buffer", interrupted):
            with self.assertRaises(KeyboardInterrupt):
                record(env, lodestone.Expert(), "short-v0")
        self.assertEqual(len(self._play_again(minari.load_dataset("short-v0"))), 1)

    def test_whatever_is_wrong_is_refused_by_name(self) -> None:
        env, expert = gymnasium.make(ID, blueprint="2_000"), lodestone.Expert()
        record(env, expert, "taken-v0", episodes=1)
        for args, options, words in (
            ((lodestone.AssemblyEnv(blueprint="2_000"), expert, "x-v0"), {}, "env is .*gymnasium.make"),
            ((env, 3, "x-v0"), {}, "agent is 3"),
            ((env, expert, "x"), {}, "name is 'x'.*lodestone/expert-v0"),
            ((env, expert, "../x-v0"), {}, "name is '../x-v0'"),
            ((env, expert, "taken-v0"), {}, "taken-v0 already exists"),
            ((env, expert, "x-v0"), {"episodes": 0}, "episodes is 0"),
            ((env, expert, "x-v0"), {"seed": -1}, "seed is -1"),
            ((env, expert, "x-v0"), {"deterministic": 1}, "deterministic is 1"),
            ((env, expert, "x-v0"), {"deterministic": False}, "deterministic is False"),
        ):
            with self.subTest(words), self.assertRaisesRegex(ValueError, words):
                record(*args, **options)
        refused = subprocess.run([*COMMAND, "--sampled"], check=False, capture_output=True, text=True)
        self.assertEqual(refused.returncode, 2)
        self.assertIn("the expert has nothing to sample", refused.stderr)
        self.assertEqual([path.name for path in self.folder.iterdir()], ["taken-v0"])

    def test_what_is_not_installed_is_named(self) -> None:
        env = gymnasium.make(ID, blueprint="2_000")
        for package in ("minari", "pyarrow", "PIL"):
            with mock.patch.dict(sys.modules, {package: None}), self.assertRaises(DependencyNotInstalled) as raised:
                record(env, lodestone.Expert(), "x-v0")
            self.assertIn('pip install "minari[arrow]" pillow', str(raised.exception))

    def _play_again(self, dataset: MinariDataset) -> list[dict[str, Any]]:
        """Replays every episode in the dataset's environment, checks that the data match, and returns the metadata."""
        env = dataset.recover_environment()
        told = list(dataset.storage.get_episode_metadata(dataset.episode_indices))
        for episode, about in zip(dataset.iterate_episodes(), told, strict=True):
            seen, info = env.reset(seed=about["seed"], options=about["options"])
            self.assertEqual(info, {**about["options"], "start": about["start"]})
            self._same(seen, episode.observations, 0)
            for step in range(len(episode)):
                seen, reward, terminated, truncated, info = env.step(row_of(episode.actions, step))
                self._same(seen, episode.observations, step + 1)
                self.assertEqual(reward, episode.rewards[step])
                self.assertEqual((terminated, truncated), (episode.terminations[step], episode.truncations[step]))
                self.assertEqual(info["is_success"], episode.infos["is_success"][step + 1])
                np.testing.assert_array_equal(info["reward_terms"], episode.infos["reward_terms"][step + 1])
            self.assertTrue(terminated or truncated)
            self.assertEqual((about["total_steps"], about["is_success"]), (len(episode), terminated))
            self.assertEqual(set(episode.infos["blueprint"]), {about["options"]["blueprint"]})
        self.assertEqual(dataset.total_steps, sum(about["total_steps"] for about in told))
        return told

    def _same(self, seen: Any, observations: Any, row: int) -> None:
        self.assertTrue(data_equivalence(seen, row_of(observations, row), exact=True), f"row {row}")


if __name__ == "__main__":
    unittest.main()

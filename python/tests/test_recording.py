"""Reads the datasets that `lodestone record` writes with Minari and replays them in the environment.

LODESTONE_PROGRAM=target/debug/lodestone python -m unittest discover -s python/tests
"""

from __future__ import annotations

import os
import subprocess
import tempfile
import unittest
from pathlib import Path
from typing import Any

import gymnasium
import lodestone  # noqa: F401, registers the environment
import minari
import numpy as np
from gymnasium.utils.env_checker import data_equivalence
from minari import EpisodeData, MinariDataset

ID = "Lodestone/Assembly-v0"
CATALOG = Path(__file__).parents[2] / "blueprints/catalog"
PROGRAM = os.environ.get("LODESTONE_PROGRAM")


@unittest.skipUnless(PROGRAM, "LODESTONE_PROGRAM names no program, so no dataset was read")
class Recording(unittest.TestCase):
    def setUp(self) -> None:
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)
        os.environ["MINARI_DATASETS_PATH"] = folder.name

    def record(self, name: str, *args: str) -> MinariDataset:
        command = [str(PROGRAM), "record", "--out", str(self.folder), "--name", name, *args]
        subprocess.run(command, check=True, capture_output=True)
        return minari.load_dataset(name)

    def test_a_learner_finds_the_spaces_of_the_environment(self) -> None:
        dataset = self.record("lodestone/two-v0", "--expert", "--blueprint", "2_000", "--episodes", "2")
        env = gymnasium.make(ID, blueprint="2_000")
        self.assertEqual(dataset.observation_space, env.observation_space)
        self.assertEqual(dataset.action_space, env.action_space)
        for episode in dataset:
            for row in range(len(episode)):
                self.assertIn(_row(episode.observations, row), env.observation_space)
                self.assertIn(_row(episode.actions, row), env.action_space)
        listed = minari.list_local_datasets()
        self.assertEqual(list(listed), ["lodestone/two-v0"])
        self.assertEqual(listed["lodestone/two-v0"]["algorithm_name"], "expert")

    def test_the_expert_is_seen_to_do_the_same_again(self) -> None:
        args = ("--blueprint", "2_000", "--blueprint", "4_001", "--start", "mixed", "--episodes", "5")
        dataset = self.record("lodestone/expert-v0", "--expert", *args)
        self.assertEqual(dataset.total_episodes, 10)
        starts = self._play_again(dataset)
        self.assertEqual(sum(start.startswith("prebuilt:") for start in starts), 2)

    def test_the_policy_is_seen_to_do_the_same_again(self) -> None:
        own = self.folder / "mine.toml"
        own.write_text((CATALOG / "3_000.toml").read_text().replace('"3_000"', '"mine_3_000"'))
        # Non-default world settings as well.
        world = ("--set", "environment.episode_steps=20", "--set", "environment.physics.friction=0.5")
        dataset = self.record("policy-v3", "--blueprint", str(own), "--episodes", "3", *world)
        own.unlink()
        self._play_again(dataset)
        self.assertEqual({name for episode in dataset for name in episode.infos["blueprint"]}, {"mine_3_000"})
        sampled = self.record("sampled-v0", "--sampled", "--blueprint", "2_000", "--episodes", "1", *world)
        self._play_again(sampled)

    def _play_again(self, dataset: MinariDataset) -> list[str]:
        """Replays every episode in the dataset's environment, checks that the data match, and returns the starts."""
        env = dataset.recover_environment()
        starts = []
        n_steps = 0
        metadata = dataset.storage.get_episode_metadata(dataset.episode_indices)
        for episode, about in zip(dataset.iterate_episodes(), metadata, strict=True):
            seen, info = env.reset(seed=about["seed"], options=about["options"])
            self.assertEqual(info, about["options"])
            self._same(seen, episode, 0)
            for step in range(len(episode)):
                seen, reward, terminated, truncated, info = env.step(_row(episode.actions, step))
                self._same(seen, episode, step + 1)
                self.assertEqual(reward, episode.rewards[step])
                self.assertEqual((terminated, truncated), (episode.terminations[step], episode.truncations[step]))
                self.assertEqual(info["is_success"], episode.infos["is_success"][step + 1])
                np.testing.assert_array_equal(info["reward_terms"], episode.infos["reward_terms"][step + 1])
            self.assertTrue(terminated or truncated)
            self.assertEqual((about["total_steps"], about["is_success"]), (len(episode), terminated))
            starts.append(about["options"]["start"])
            n_steps += len(episode)
        self.assertEqual(dataset.total_steps, n_steps)
        return starts

    def _same(self, seen: Any, episode: EpisodeData, row: int) -> None:
        self.assertTrue(data_equivalence(seen, _row(episode.observations, row), exact=True), f"row {row}")


def _row(columns: dict[str, np.ndarray], row: int) -> dict[str, np.ndarray]:
    return {name: column[row] for name, column in columns.items()}


if __name__ == "__main__":
    unittest.main()

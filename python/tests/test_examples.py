"""Tests that the examples run, with few steps.

python -m unittest discover -s python/tests
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path
from typing import Any

import lodestone

EXAMPLES = Path(__file__).parents[1] / "examples"
LAB = Path(__file__).parents[2] / "lab"
PROGRAM = os.environ.get("LODESTONE_PROGRAM")
# Settings of a training that takes a moment.
SMALL = (
    "learner.batch_size=256",
    "learner.minibatch_size=256",
    "learner.n_epochs=1",
    "actor.n_worlds=8",
    'evaluator.selection.blueprints=["2_000","2_001"]',
    "evaluator.episodes.n_episodes=2",
    "policy.network.width=16",
    "policy.network.value_hidden=[16]",
    "evaluator.videos.groups=[]",
)


def needs(*packages: str):
    """Packages that only the nightly checks install."""
    missing = [name for name in packages if importlib.util.find_spec(name) is None]
    return unittest.skipIf(missing, f"not run: no package {', '.join(missing)}")


def learning() -> Any:
    """Returns the module of lab/learning.py."""
    spec = importlib.util.spec_from_file_location("learning", LAB / "learning.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def write_metrics(folder: Path, updates: list[tuple[int, int]]) -> Path:
    """Writes a run's metrics: a learner's line each for these successes and episodes, and one of an actor."""
    lines = [{"key": "actor/a"}]
    for i, (n_successes, n_episodes) in enumerate(updates, 1):
        success = {"n_successes": n_successes, "n_episodes": n_episodes}
        line = {"key": "learner", "n_env_steps": 100 * i, "elapsed_s": i, "run_elapsed_s": 0}
        lines.append({**line, "episodes": {"success": success}})
    path = folder / "metrics.jsonl"
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


class Examples(unittest.TestCase):
    def run_example(self, name: str, *args: str, **environment: str) -> str:
        """Runs an example; returns what it prints."""
        command = [sys.executable, str(EXAMPLES / name), *args]
        environment = {**os.environ, "OMP_NUM_THREADS": "1", **environment}
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done.stdout

    def test_ppo_learns_to_build_goals_of_two_blocks(self) -> None:
        # Twelve updates instead of the default 58.
        with tempfile.TemporaryDirectory() as folder:
            metrics = Path(folder, "ppo.jsonl")
            lines = self.run_example("ppo.py", "--steps", "12288", "--metrics", str(metrics)).splitlines()
            learned = learning().curve(metrics)
        self.assertEqual([moment.n_env_steps for moment in learned][-3:], [10240, 11264, 12288])
        # The first of them are means of a few episodes only.
        self.assertGreater(learned[-1].success, 0.6)
        shares = [re.fullmatch(r"(?:un)?trained, builds (\d+)% of 64 trials", line) for line in (lines[0], lines[-1])]
        before, after = (int(found[1]) if found else -1 for found in shares)
        # 47% and 100%; random picks build two fifths.
        self.assertGreaterEqual(before, 0, lines)
        self.assertGreater(after, before + 30, lines)
        reports = [
            re.fullmatch(r" *[\d,]+ steps  success +\d+% of the last \d+  [\d,]+ steps/s", x) for x in lines[1:-1]
        ]
        self.assertEqual([bool(found) for found in reports], [True] * 3, lines)

    def test_a_curve_is_success_of_the_last_episodes(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            metrics = write_metrics(Path(folder), [(50, 100), (100, 100), (0, 100), (1, 1000), (0, 0)])
            found = [(moment.n_env_steps, moment.success) for moment in learning().curve(metrics)]
            # The first update leaves with the third, which makes 200 episodes without it.
            self.assertEqual(found, [(100, 0.5), (200, 0.75), (300, 0.5), (400, 0.001), (500, 0.001)])
            metrics.write_text("{}")
            with self.assertRaisesRegex(SystemExit, "metrics.jsonl:1 is no line of metrics"):
                learning().curve(metrics)

    @needs("matplotlib")
    def test_learning_curves_are_drawn(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            metrics = write_metrics(Path(folder), [(50, 200), (100, 200)])
            picture = Path(folder, "learning.png")
            command = [sys.executable, str(LAB / "learning.py"), str(picture), f"one file={metrics}", str(metrics)]
            subprocess.run(command, check=True, capture_output=True)
            self.assertEqual(picture.read_bytes()[1:4], b"PNG")

    @needs("sb3_contrib")
    def test_stable_baselines_learns_and_builds(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            args = ("--steps", "2048", "--worlds", "16", "--rollout", "64", "--out", f"{folder}/policy.zip")
            lines = self.run_example("stable_baselines.py", *args).splitlines()
            self.assertTrue(Path(folder, "policy.zip").is_file())
        # Random picks build two fifths.
        found = re.fullmatch(r"builds (\d+)% of 64 trials", lines[-1])
        self.assertGreater(int(found[1]) if found else -1, 20, lines[-1])

    @needs("optuna")
    @unittest.skipUnless(PROGRAM, "LODESTONE_PROGRAM names no program, so nothing was tuned")
    def test_optuna_goes_on_with_its_trials(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            args = ["--program", str(PROGRAM), "--steps", "1024", "--seeds", "1", "--trials", "1", "--out", folder]
            for setting in SMALL:
                args += ["--set", setting]
            for n in (1, 2):
                printed = self.run_example("tune.py", *args)
                self.assertRegex(printed, rf"best of {n} trials: \d+\.\d% with {{'learning_rate': [^,]+, 'gamma': 0\.9\d+}}")

    @needs("rerun")
    def test_rerun_reads_an_episode(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = f"{folder}/episode.rrd"
            printed = self.run_example("rerun_episode.py", "--blueprint", "2_000", "--out", path)
            self.assertRegex(printed, r"episode\.rrd: 2_000, \d+ steps, built")
            read = [sys.executable, "-m", "rerun", "rrd"]
            subprocess.run([*read, "verify", path], check=True, capture_output=True)
            told = subprocess.run([*read, "print", path], check=True, capture_output=True, text=True).stdout
        for entity in ("/world/blocks", "/world/connections", "/picture", "/return", "/reward/connected"):
            self.assertIn(f" {entity} - data columns:", told)

    @needs("yaml")
    def test_a_hub_gets_a_policy_and_a_dataset_with_cards(self) -> None:
        import yaml

        with tempfile.TemporaryDirectory() as folder:
            self.run_example("hub.py", "model", f"{folder}/model", "--split", "2_000", "--episodes", "2")
            policy = lodestone.Policy.load(f"{folder}/model/policy.safetensors")
            self.assertEqual(policy.version, lodestone.Policy.pretrained().version)
            home = {"MINARI_DATASETS_PATH": f"{folder}/minari"}
            record = [sys.executable, "-m", "lodestone.record", "--blueprint", "2_000", "--episodes", "1"]
            subprocess.run(record, env={**os.environ, **home}, check=True, capture_output=True)
            self.run_example("hub.py", "dataset", f"{folder}/dataset", **home)
            self.assertTrue(Path(folder, "dataset/datasets/lodestone/expert-v0/data").is_dir())
            heads = []
            for kind in ("model", "dataset"):
                _, head, body = Path(folder, kind, "README.md").read_text().split("---\n", 2)
                heads.append(yaml.safe_load(head))
                self.assertNotIn("](", body)
        metric = heads[0]["model-index"][0]["results"][0]["metrics"][0]
        self.assertEqual(metric, {"type": "success_rate", "value": 1.0, "name": "greedy, 2 episodes"})
        self.assertEqual(heads[1]["task_categories"], ["reinforcement-learning", "robotics"])


if __name__ == "__main__":
    unittest.main()

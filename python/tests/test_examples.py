"""The examples run as their first lines say, with fewer steps.

python -m unittest discover -s python/tests
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

EXAMPLES = Path(__file__).parents[1] / "examples"


def run(name: str, *args: str, **environment: str) -> str:
    """What an example prints; fails with its errors if it fails."""
    command = [sys.executable, str(EXAMPLES / name), *args]
    done = subprocess.run(command, env={**os.environ, **environment}, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise AssertionError(f"{name} ended with {done.returncode}: {done.stdout}{done.stderr}")
    return done.stdout


class Examples(unittest.TestCase):
    def test_ppo_learns_beside_the_goal(self) -> None:
        # 20 updates; the default is 300.
        lines = run("ppo.py", "--steps", "20480").splitlines()
        shares = [int(found[1]) for line in lines if (found := re.search(r"success +(\d+)%", line))]
        self.assertEqual(len(shares), 4, lines)
        self.assertIn("20,480 steps", lines[-1])
        self.assertGreater(shares[-1], shares[0])

    def test_record_makes_a_dataset(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            args = ("--blueprint", "2_000", "--episodes", "3")
            printed = run("record.py", *args, MINARI_DATASETS_PATH=folder)
            self.assertRegex(printed, r"lodestone/2_000/expert-v0: 3 episodes, \d+ steps, 3 built")
            self.assertTrue((Path(folder) / "lodestone/2_000/expert-v0/data").is_dir())


if __name__ == "__main__":
    unittest.main()

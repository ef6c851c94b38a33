"""Tests that the examples run, with few steps. Skips `record.py` because Minari's collector needs jax.

python -m unittest discover -s python/tests
"""

from __future__ import annotations

import re
import subprocess
import sys
import unittest
from pathlib import Path

EXAMPLES = Path(__file__).parents[1] / "examples"


class Examples(unittest.TestCase):
    def test_ppo_steps_learns_and_reports(self) -> None:
        # Five updates instead of the default 293: too few to succeed, but enough to exercise every part.
        command = [sys.executable, str(EXAMPLES / "ppo.py"), "--steps", "5120"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        self.assertEqual(done.returncode, 0, done.stderr)
        found = re.fullmatch(r" *5,120 steps  success +\d+% of the last (\d+)  [\d,]+ steps/s\n", done.stdout)
        self.assertIsNotNone(found, done.stdout)
        # 32 worlds run 160 steps each. Episodes last at most 100 steps, so every world finishes at least one.
        self.assertGreaterEqual(int(found[1]) if found else 0, 32)


if __name__ == "__main__":
    unittest.main()

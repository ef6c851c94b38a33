"""Tests that the examples run, with few steps.

python -m unittest discover -s python/tests
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import unittest
from pathlib import Path

EXAMPLES = Path(__file__).parents[1] / "examples"


class Examples(unittest.TestCase):
    def test_ppo_learns_to_build_goals_of_two_blocks(self) -> None:
        # Twelve updates instead of the default 58.
        command = [sys.executable, str(EXAMPLES / "ppo.py"), "--steps", "12288"]
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
        self.assertEqual(done.returncode, 0, done.stderr)
        lines = done.stdout.splitlines()
        shares = [re.fullmatch(r"(?:un)?trained, builds (\d+)% of 64 trials", line) for line in (lines[0], lines[-1])]
        before, after = (int(found[1]) if found else -1 for found in shares)
        # 47% and 100%; random picks build two fifths.
        self.assertGreaterEqual(before, 0, done.stdout)
        self.assertGreater(after, before + 30, done.stdout)
        reports = [
            re.fullmatch(r" *[\d,]+ steps  success +\d+% of the last \d+  [\d,]+ steps/s", x) for x in lines[1:-1]
        ]
        self.assertEqual([bool(found) for found in reports], [True] * 3, done.stdout)


if __name__ == "__main__":
    unittest.main()

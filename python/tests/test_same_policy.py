"""Compares Rust and the PyTorch module on the same policy file and observations from real worlds.

python -m unittest discover -s python/tests
"""

from __future__ import annotations

import json
import math
import tempfile
import unittest
from pathlib import Path

import golden
import lodestone
import lodestone_torch
import numpy as np
import torch
from numpy.typing import NDArray

# As in the reference tests in Rust. With one build of torch 2.15, the two were 1.7e-5 apart: 1.1e-5 and 1.4e-5 from
# float64.
TOLERANCE = 2e-5
# Goals with few blocks, with many, and one that no policy was trained on.
BLUEPRINTS = ("2_000", "6_005", "12_000", "test_14_000")
N_STEPS = 15


def seen_while_acting(policy: lodestone.Policy) -> list[NDArray[np.float32]]:
    """Returns the nodes, edges, and globals that the policy observes while acting, [blueprints · steps, …]."""
    seen = []
    for seed, blueprint in enumerate(BLUEPRINTS):
        env = lodestone.AssemblyEnv(blueprint=blueprint)
        observation, _ = env.reset(seed=seed)
        for _ in range(N_STEPS):
            seen.append(observation)
            observation, _, terminated, truncated, _ = env.step(policy.act(env))
            if terminated or truncated:
                observation, _ = env.reset()
    return [np.stack([one[name] for one in seen]) for name in ("nodes", "edges", "globals")]


class SamePolicy(unittest.TestCase):
    @classmethod
    def setUpClass(cls) -> None:
        cls.seen = seen_while_acting(lodestone.Policy.pretrained())

    def assert_close(self, ours: torch.Tensor, theirs: torch.Tensor, what: str) -> None:
        """Compares relative to the largest entry, because a single entry may happen to be close to 0."""
        self.assertEqual(ours.shape, theirs.shape, what)
        error = ((ours - theirs).abs().max() / theirs.abs().max()).item()
        self.assertLessEqual(error, TOLERANCE, f"{what} are off by {error:.1e} of the largest")

    def assert_same(self, policy: lodestone_torch.Policy, native: lodestone.Policy) -> None:
        """Compares both outputs for the scenes: values, choices, mean moves, and log-probabilities of these actions."""
        (choices, moves), log_probs, values = native.native.act(*self.seen, False)
        chosen = torch.from_numpy(choices)
        logits, locs, scales, ours = policy(*(torch.from_numpy(x) for x in self.seen))
        self.assert_close(ours, torch.from_numpy(values), "values")
        self.assert_close(locs, torch.from_numpy(moves), "moves")
        # Compare logits, not block indices: rounding decides between equally good blocks.
        best = logits.amax(-1)
        self.assert_close(logits.gather(-1, chosen.unsqueeze(-1)).squeeze(-1), best, "logits of the choices")
        # Only the moves of chosen blocks count, once each. At the mean, the density depends only on the deviations.
        is_chosen = torch.nn.functional.one_hot(chosen, 16).amax(1)
        densities = (-scales.log() - 0.5 * math.log(2 * math.pi)).sum(-1)
        total = (best - logits.logsumexp(-1)).sum(-1) + (densities * is_chosen).sum(-1)
        self.assert_close(total, torch.from_numpy(log_probs), "log-probabilities")

    def test_the_shipped_policy_is_the_same_in_both(self) -> None:
        self.assertEqual(len(self.seen[0]), len(BLUEPRINTS) * N_STEPS)
        self.assert_same(lodestone_torch.Policy.load(golden.PRETRAINED), lodestone.Policy.pretrained())

    def test_a_saved_policy_is_the_same_in_both(self) -> None:
        """Changes the shipped parameters and adds feature and value statistics, which the shipped policy lacks."""
        policy = lodestone_torch.Policy.load(golden.PRETRAINED)
        with torch.no_grad():
            for name, value in policy.network.named_parameters():
                value += 0.01 * torch.from_numpy(golden.generate(name, 1, value.numel())).reshape(value.shape)
        header = json.loads(json.dumps(policy.header))
        columns = [x.reshape(-1, x.shape[-1]) for x in self.seen]
        header["normalization"] = {
            "feature_mean": [x.mean(0).tolist() for x in columns],
            # Keeps nearly constant features from becoming huge.
            "feature_std": [x.std(0).clip(0.1).tolist() for x in columns],
            "value_mean": 3.0,
            "value_std": 2.0,
        }
        header["weights_version"] += 1
        changed = lodestone_torch.Policy(policy.network, header)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "policy.safetensors")
            changed.save(path)
            native, again = lodestone.Policy.load(path), lodestone_torch.Policy.load(path)
        self.assertEqual(native.version, lodestone.Policy.pretrained().version + 1)
        self.assert_same(again, native)
        shipped = lodestone.Policy.pretrained().native.act(*self.seen, False)[2]
        self.assertGreater(np.abs(native.native.act(*self.seen, False)[2] - shipped).max(), 1.0)

    def test_the_shipped_policy_saved_again_acts_bit_for_bit(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "policy.safetensors")
            lodestone_torch.Policy.load(golden.PRETRAINED).save(path)
            saved = lodestone.Policy.load(path)
        (choices, moves), _, values = saved.native.act(*self.seen, False)
        (expected_choices, expected_moves), _, expected = lodestone.Policy.pretrained().native.act(*self.seen, False)
        np.testing.assert_array_equal(choices, expected_choices)
        np.testing.assert_array_equal(moves, expected_moves)
        np.testing.assert_array_equal(values, expected)


if __name__ == "__main__":
    unittest.main()

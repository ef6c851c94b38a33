"""Compares Rust and the PyTorch module on the same policy file and observations from real worlds.

python -m unittest discover -s python/tests
"""

from __future__ import annotations

import json
import math
import os
import pickle
import re
import struct
import subprocess
import tempfile
import unittest
from pathlib import Path
from typing import Any

import golden
import lodestone
import lodestone_torch
import numpy as np
import torch
from gymnasium.utils.env_checker import data_equivalence
from numpy.typing import NDArray

# As in the reference tests in Rust. With one build of torch 2.15, the two were 1.7e-5 apart: 1.1e-5 and 1.4e-5 from
# float64.
TOLERANCE = 2e-5
# Goals with few blocks, with many, and one that no policy was trained on.
BLUEPRINTS = ("2_000", "6_005", "12_000", "test_14_000")
N_STEPS = 15
PROGRAM = os.environ.get("LODESTONE_PROGRAM")
# An action in a recording (proto/proto/lodestone.proto): a block for each gripper, and 16 × 6 moves.
ACTION = re.compile(rb"\x08(.)\x10(.)\x1a\x80\x03(.{384})", re.DOTALL)


def recorded_actions(path: Path) -> list[dict[str, NDArray[Any]]]:
    """Returns the actions in a recording of the program, as the environment takes them."""
    found = ACTION.findall(path.read_bytes())
    moves = [np.frombuffer(moves, "<f4").reshape(16, 6).clip(-1.0, 1.0) for *_, moves in found]
    return [{"choices": np.array([*a, *b]), "moves": x} for (a, b, _), x in zip(found, moves, strict=True)]


def episode_seed(blueprint: str, number: int) -> int:
    """Returns the seed with which the program records an episode: FNV-1a of its own seed, 0, and the arguments."""
    seed = 0xCBF29CE484222325
    for byte in struct.pack("<Q", 0) + blueprint.encode() + struct.pack("<Q", number):
        seed = (seed ^ byte) * 0x100000001B3 % 2**64
    return seed


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


class SameGaussian(unittest.TestCase):
    @classmethod
    def setUpClass(cls) -> None:
        cls.seen = seen_while_acting(golden.native(golden.gaussian()))

    def assert_close(self, ours: torch.Tensor, theirs: torch.Tensor, what: str) -> None:
        """Compares relative to the largest entry, because a single entry may happen to be close to 0."""
        self.assertEqual(ours.shape, theirs.shape, what)
        error = ((ours - theirs).abs().max() / theirs.abs().max()).item()
        self.assertLessEqual(error, TOLERANCE, f"{what} are off by {error:.1e} of the largest")

    def assert_same(self, policy: lodestone_torch.Policy, native: lodestone.Policy) -> None:
        """Compares both outputs for the scenes: values, choices, mean moves, and log-probabilities of these actions."""
        (choices, moves), log_probs, values, _ = native.native.act(*self.seen, False)
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

    def test_a_policy_is_the_same_in_both(self) -> None:
        self.assertEqual(len(self.seen[0]), len(BLUEPRINTS) * N_STEPS)
        self.assert_same(golden.gaussian(), golden.native(golden.gaussian()))

    def test_statistics_are_the_same_in_both(self) -> None:
        """Changes the parameters and adds statistics of features and values."""
        policy = golden.gaussian()
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
        self.assertEqual(native.version, policy.header["weights_version"] + 1)
        self.assert_same(again, native)
        before = golden.native(golden.gaussian()).native.act(*self.seen, False)[2]
        self.assertGreater(np.abs(native.native.act(*self.seen, False)[2] - before).max(), 0.5)


class SameMixture(unittest.TestCase):
    """A policy with the mixture head, while it acts."""

    def test_drawn_and_greedy_actions_have_the_same_log_probabilities(self) -> None:
        for n_grippers in (1, 2):
            policy = golden.mixture(n_grippers)
            native = golden.native(policy)
            envs = lodestone.AssemblyVectorEnv(
                8, blueprint=BLUEPRINTS, features="paper", settings={"n_grippers": n_grippers}
            )
            for sampled in (False, True):
                seen, _ = envs.reset(seed=1)
                kinds: set[int] = set()
                for _ in range(N_STEPS):
                    with self.subTest(n_grippers=n_grippers, sampled=sampled):
                        kinds |= self.compare(policy, native, envs, seen, sampled)
                    seen, *_ = envs.step(native.act(envs, deterministic=not sampled))
                self.assertLessEqual({0, 2} if sampled else {0}, kinds)

    def test_the_shipped_policy_is_the_same_in_both(self) -> None:
        policy, native = lodestone_torch.Policy.load(golden.PRETRAINED), lodestone.Policy.pretrained()
        envs = lodestone.AssemblyVectorEnv(len(BLUEPRINTS), blueprint=BLUEPRINTS, features="paper")
        seen, _ = envs.reset(seed=1)
        for step in range(2 * N_STEPS):
            sampled = step % 2 == 1
            self.compare(policy, native, envs, seen, sampled)
            seen, *_ = envs.step(native.act(envs, deterministic=not sampled))

    def test_the_shipped_policy_saved_again_acts_bit_for_bit(self) -> None:
        saved, shipped = golden.native(lodestone_torch.Policy.load(golden.PRETRAINED)), lodestone.Policy.pretrained()
        envs = lodestone.AssemblyVectorEnv(len(BLUEPRINTS), blueprint=BLUEPRINTS)
        envs.reset(seed=1)
        for _ in range(N_STEPS):
            self.assertTrue(data_equivalence(saved.act(envs), shipped.act(envs), exact=True))
            envs.step(shipped.act(envs))

    def compare(
        self, policy: lodestone_torch.Policy, native: lodestone.Policy, envs: Any, seen: Any, sampled: bool
    ) -> set[int]:
        """Compares one batch of actions; returns the kinds of proposals that were drawn."""
        parts = [seen[name] for name in ("nodes", "edges", "globals")]
        (choices, moves), log_probs, values, slots = native.native.act(*parts, sampled, envs.batch.worlds)
        found = lodestone.proposals(envs)
        proposals = lodestone_torch.Proposals(*(torch.from_numpy(found[name]) for name in ("relations", "offered")))
        output = policy(*(torch.from_numpy(x) for x in parts))
        allowed = torch.from_numpy(envs.batch.worlds.allowed()).unsqueeze(1)
        output = output._replace(logits=output.logits.masked_fill(~allowed, lodestone_torch.MASKED))
        pairs = zip(torch.from_numpy(choices).unbind(-1), torch.from_numpy(slots).unbind(-1))
        draws = [lodestone_torch.Draw(*pair) for pair in pairs]
        ours = lodestone_torch.log_prob(output, proposals, draws)
        np.testing.assert_allclose(ours, log_probs, rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(output.values, values, rtol=1e-4, atol=1e-4)
        kinds: set[int] = set()
        for gripper, (blocks, picked) in enumerate(zip(choices.T, slots.T)):
            first = draws[0] if gripper else None
            mine = lodestone_torch.second_logits(output, proposals, first) if first else output.logits[:, 0]
            of_blocks = lodestone_torch.slot_logits(output, proposals, first)
            if gripper == 0 and not sampled:
                moved = np.abs(moves).max((1, 2)) > 0.05
                self.assert_best_that_moves(mine, draws[0].block, of_blocks, found["moves"], moved)
            else:
                self.assert_best(mine, draws[gripper].block, sampled)
            of_block = lodestone_torch.at_block(of_blocks, draws[gripper].block)
            self.assert_best(of_block[picked >= 0], draws[gripper].slot[picked >= 0], sampled)
            np.testing.assert_array_equal(picked < 0, blocks == choices[:, 0] if gripper else False)
            kinds |= set(found["kinds"][picked[picked >= 0]].tolist())
            for row in np.flatnonzero(picked >= 0):
                block, slot = blocks[row], picked[row]
                self.assertTrue(found["offered"][row, block, slot])
                off = np.abs(moves[row, block] - found["moves"][row, block, slot])
                limit = 6 * found["noise"][row, block, slot] if sampled else 1e-4
                self.assertTrue((off < limit).all(), f"{off} from the mean")
        return kinds

    def assert_best(self, logits: torch.Tensor, chosen: torch.Tensor, sampled: bool) -> None:
        """Rounding decides between equally good options."""
        if not sampled and len(chosen):
            found = logits.gather(-1, chosen.unsqueeze(-1)).squeeze(-1)
            self.assertLessEqual((logits.amax(-1) - found).max().item(), 1e-4)

    def assert_best_that_moves(
        self, logits: torch.Tensor, chosen: torch.Tensor, slots: torch.Tensor, moves: np.ndarray, moved: np.ndarray
    ) -> None:
        """A block whose most probable action moves nothing gives way to the next two (policy/src/mixture)."""
        for row, block in enumerate(chosen):
            better = (logits[row] > logits[row, block] + 1e-4).nonzero().flatten()
            self.assertLessEqual(len(better), 2 if moved[row] else 0)
            for other in better:
                self.assertLessEqual(np.abs(moves[row, other, slots[row, other].argmax()]).max(), 0.05)

    def test_drawn_actions_follow_the_seed_and_greedy_ones_need_none(self) -> None:
        native = golden.native(golden.mixture())
        for action in ("native", "flat"):
            envs = lodestone.AssemblyVectorEnv(3, blueprint="4_000", action=action)
            envs.reset(seed=1)
            drawn = []
            for seed in (1, 1, 2):
                native.seed(seed)
                drawn.append(native.act(envs, deterministic=False))
            self.assertTrue(data_equivalence(drawn[0], drawn[1], exact=True))
            self.assertFalse(data_equivalence(drawn[0], drawn[2], exact=True))
            self.assertTrue(data_equivalence(native.act(envs), native.act(envs), exact=True))
            # A copy goes on, and a single world gets what it gets in a batch.
            again = pickle.loads(pickle.dumps(native))
            ours, theirs = (one.act(envs, deterministic=False) for one in (native, again))
            self.assertTrue(data_equivalence(ours, theirs, exact=True))
        env = lodestone.AssemblyEnv(blueprint="4_000")
        env.reset(seed=1)
        envs = lodestone.AssemblyVectorEnv(3, blueprint="4_000")
        envs.reset(seed=1)
        one, batch = native.act(env), native.act(envs)
        np.testing.assert_array_equal(one["choices"], batch["choices"][0])
        np.testing.assert_allclose(one["moves"], batch["moves"][0], atol=1e-5)

    def test_observations_alone_are_refused(self) -> None:
        native = golden.native(golden.mixture())
        env = lodestone.AssemblyEnv(blueprint="2_000", features="paper")
        seen, _ = env.reset(seed=1)
        for call in (native.predict, native.evaluate):
            with self.assertRaisesRegex(ValueError, r"do not tell what is proposed: use act\(env\)"):
                call(seen if call == native.predict else {name: x[None] for name, x in seen.items()})

    @unittest.skipUnless(PROGRAM, "LODESTONE_PROGRAM names no program, so no recording was compared")
    def test_greedy_actions_are_those_that_the_program_records(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "policy.safetensors")
            golden.mixture().save(path)
            native = lodestone.Policy.load(path)
            played = Path(folder, "played")
            args = ["--checkpoint", str(path), "--blueprint", "3_000", "--episodes", "2", "--out", str(played)]
            subprocess.run([str(PROGRAM), "record", *args], check=True, capture_output=True)
            env = lodestone.AssemblyEnv()
            for number, recording in enumerate(sorted(played.iterdir())):
                options = {"blueprint": "3_000", "start": "scattered"}
                env.reset(seed=episode_seed("3_000", number), options=options)
                has_ended = False
                for expected in recorded_actions(recording):
                    self.assertFalse(has_ended)
                    action = native.act(env)
                    self.assertTrue(data_equivalence(action, expected, exact=True))
                    _, _, terminated, truncated, _ = env.step(action)
                    has_ended = terminated or truncated
                self.assertTrue(has_ended)
            self.assertEqual(number, 1)


if __name__ == "__main__":
    unittest.main()

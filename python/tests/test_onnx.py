"""Tests that the graph of lodestone_onnx.py computes in onnxruntime what the policy computes.

python -m unittest discover -s python/tests
"""

from __future__ import annotations

import json
import tempfile
import unittest
from pathlib import Path

import golden
import lodestone
import lodestone_onnx
import lodestone_torch
import numpy as np
import onnxruntime
import torch
from lodestone_torch import MASKED, N_BLOCKS, N_RELATION, N_SLOTS, Config, Draw, GraphNetwork, Policy, Proposals

# Maximum deviation, relative to the largest entry of an output, because a single one may happen to be close to 0.
TOLERANCE = 2e-5


def exported(policy: Policy) -> onnxruntime.InferenceSession:
    with tempfile.TemporaryDirectory() as folder:
        graph = Path(folder, "policy.onnx")
        lodestone_onnx.export(policy, graph)
        return onnxruntime.InferenceSession(str(graph), providers=["CPUExecutionProvider"])


def without_attention() -> Policy:
    policy = golden.gaussian()
    header = json.loads(json.dumps(policy.header))
    header["policy"]["network"]["encoder"]["attention"] = False
    header["table"] = [x for x in header["table"] if x["name"].split(".")[1] not in ("query", "key")]
    network = GraphNetwork(Config.of(header))
    network.load_state_dict({entry["name"]: policy.network.state_dict()[entry["name"]] for entry in header["table"]})
    return Policy(network, header)


def normalized() -> Policy:
    policy = golden.mixture()
    header, c = json.loads(json.dumps(policy.header)), policy.network.config
    sizes = (c.node, c.edge, c.global_)
    # Features without statistics, like the edges here, are not normalized.
    mean, std = [[0.1] * n for n in sizes], [[0.5] * n for n in sizes]
    header["normalization"] |= {"feature_mean": [mean[0], [], mean[2]], "feature_std": [std[0], [], std[2]]}
    return Policy(policy.network, header)


def numbers(name: str, *shape: int) -> np.ndarray:
    return golden.generate(name, 1, int(np.prod(shape))).reshape(shape).astype(np.float32)


def inputs(policy: Policy, b: int) -> dict[str, np.ndarray]:
    c = policy.network.config
    feed = {"nodes": numbers("n", b, N_BLOCKS, c.node), "edges": numbers("e", b, 240, c.edge)}
    feed["globals"] = numbers("g", b, c.global_)
    if c.mixture:
        feed["relations"] = np.abs(numbers("r", b, N_BLOCKS, N_BLOCKS, N_RELATION)).round(1)
        feed["offered"] = numbers("o", b, N_BLOCKS, N_SLOTS) > 0.0
        if c.n_grippers == 2:
            feed["first"] = np.array([[3, 5], [0, 32], [7, 17], [8, 16], [15, 0]])[:b]
    return feed


def expected(policy: Policy, feed: dict[str, np.ndarray]) -> dict[str, torch.Tensor]:
    """Computes the same in PyTorch."""
    given = {name: torch.from_numpy(x) for name, x in feed.items()}
    output = policy(given["nodes"], given["edges"], given["globals"])
    outputs = {name: x for name, x in output._asdict().items() if name != "readouts"}
    if "offered" in given:
        proposals = Proposals(given["relations"], given["offered"])
        outputs["first_slots"] = lodestone_torch.slot_logits(output, proposals)
        if "first" in given:
            first = Draw(*given["first"].unbind(-1))
            outputs["second_blocks"] = lodestone_torch.second_logits(output, proposals, first)
            outputs["second_slots"] = lodestone_torch.slot_logits(output, proposals, first)
    return outputs


class Onnx(unittest.TestCase):
    def assert_close(self, ours: np.ndarray, wanted: np.ndarray, what: str) -> None:
        self.assertEqual(ours.shape, wanted.shape, what)
        masked = wanted < -1e8
        np.testing.assert_array_equal(ours < -1e8, masked, what)
        ours, wanted = ours[~masked], wanted[~masked]
        error = np.abs(ours - wanted).max() / np.abs(wanted).max()
        self.assertLessEqual(error, TOLERANCE, f"{what} is off by {error:.1e} of its largest entry")

    def test_each_kind_of_policy_computes_the_same(self) -> None:
        made = (golden.gaussian(), without_attention(), golden.mixture(1), golden.mixture(2), normalized())
        for policy in made:
            session = exported(policy)
            for b in (1, 2, 5):
                with self.subTest(policy.network.config, b=b):
                    feed = inputs(policy, b)
                    self.assertEqual([x.name for x in session.get_inputs()], list(feed))
                    wanted = expected(policy, feed)
                    names = [x.name for x in session.get_outputs()]
                    self.assertEqual(set(names), set(wanted))
                    for name, ours in zip(names, session.run(None, feed), strict=True):
                        self.assert_close(ours, wanted[name].numpy(), name)

    def test_the_shipped_policy_acts_as_itself(self) -> None:
        """In real scenes: the same values, and the same greedy draws of both grippers."""
        native, session = lodestone.Policy.pretrained(), exported(Policy.load(golden.PRETRAINED))
        envs = lodestone.AssemblyVectorEnv(4, blueprint=["3_000", "6_005", "test_14_000"], features="paper")
        seen, _ = envs.reset(seed=1)
        for step in range(15):
            parts = [seen[name] for name in ("nodes", "edges", "globals")]
            (choices, _), _, values, slots = native.native.act(*parts, False, envs.batch.worlds)
            found = lodestone.proposals(envs)
            feed = {**seen, "relations": found["relations"], "offered": found["offered"]}
            feed["first"] = np.stack([choices[:, 0], slots[:, 0]], axis=1)
            ran = dict(zip((x.name for x in session.get_outputs()), session.run(None, feed), strict=True))
            with self.subTest(step=step):
                self.assert_close(ran["values"], values, "values")
                allowed = envs.batch.worlds.allowed()
                draws = ((ran["logits"][:, 0], ran["first_slots"]), (ran["second_blocks"], ran["second_slots"]))
                for gripper, (blocks, of_blocks) in enumerate(draws):
                    self.assert_best(np.where(allowed, blocks, MASKED), choices[:, gripper])
                    drew = np.flatnonzero(slots[:, gripper] >= 0)
                    self.assert_best(of_blocks[drew, choices[drew, gripper]], slots[drew, gripper])
            seen, *_ = envs.step(native.act(envs))

    def assert_best(self, logits: np.ndarray, chosen: np.ndarray) -> None:
        """Rounding decides between equally good options."""
        best = logits[np.arange(len(chosen)), chosen]
        self.assertLessEqual((logits.max(-1) - best).max(), 1e-4)


if __name__ == "__main__":
    unittest.main()

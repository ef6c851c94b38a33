"""Tests the PyTorch module against the reference values and its unfolded definition.

python -m unittest discover -s python/tests
"""

from __future__ import annotations

import json
import math
import tempfile
import unittest
from pathlib import Path

import golden
import numpy as np
import torch
from lodestone_torch import (
    N_BLOCKS,
    N_RELATION,
    N_SLOTS,
    Config,
    Draw,
    GraphLayer,
    GraphNetwork,
    Output,
    Policy,
    Proposals,
    digest,
    log_prob,
    parts_of,
)
from safetensors.torch import save_file

TOLERANCE = 1e-5
SETS = ("set_a_gat.compact.json", "set_d_noatt.compact.json")


def loss(output: Output) -> torch.Tensor:
    """Computes the loss whose gradients the golden files hold."""
    logits, locs, scales, values = output
    return values.sum() + logits.square().sum() + locs.square().sum() + scales.log().sum()


def scenes(policy: Policy, b: int, seed: int = 1) -> list[torch.Tensor]:
    """Generates features in the policy's sizes. Each gripper holds one block or none."""
    c = policy.network.config
    shapes = {"nodes": (b, 16, c.node), "edges": (b, 240, c.edge), "globals": (b, c.global_)}
    made = [0.5 * golden.generate(f"in.{name}", seed, math.prod(s)).reshape(s) for name, s in shapes.items()]
    held = made[2].reshape(b, c.n_grippers, -1)[:, :, -16:]
    held[:] = 0.0
    held[0, 0, 3] = 1.0
    return [torch.from_numpy(x.astype(np.float32)) for x in made]


def plain(policy: Policy) -> Policy:
    """Returns the policy without feature and value statistics."""
    header = json.loads(json.dumps(policy.header))
    header["normalization"] = {"feature_mean": [[]] * 3, "feature_std": [[]] * 3, "value_mean": 0.0, "value_std": 1.0}
    return Policy(policy.network, header)


class Case(unittest.TestCase):
    def assert_close(self, ours: torch.Tensor, expected: torch.Tensor, limit: float, what: str) -> None:
        """Compares relative to the largest expected entry, because a single value may happen to be close to 0."""
        self.assertEqual(ours.shape, expected.shape, what)
        largest = max(expected.abs().max().item(), 0.1)
        error = (ours.double() - expected.double()).abs().max().item() / largest
        self.assertLessEqual(error, limit, f"{what} is off by {error:.1e} of its largest entry")


class References(Case):
    def check_outputs(self, file: str, dtype: torch.dtype, limit: float) -> None:
        reference = golden.read(file)
        network = golden.network(reference).to(dtype)
        with torch.no_grad():
            output = network(*(x.to(dtype) for x in golden.inputs(reference)))
        for name, ours in zip(golden.OUTPUTS, output):
            expected = torch.tensor(reference["outputs"][name], dtype=torch.float64).reshape(ours.shape)
            self.assert_close(ours, expected, limit, f"{file}: {name}")

    def test_generator(self) -> None:
        example = golden.read("units.json")["splitmix_example"]
        self.assertEqual(golden.generate(example["name"], example["seed"], 8).tolist(), example["first8"])

    def test_outputs_in_float32(self) -> None:
        for file in SETS:
            with self.subTest(file):
                self.check_outputs(file, torch.float32, TOLERANCE)

    def test_outputs_in_float64(self) -> None:
        """The golden files store nine digits."""
        for file in SETS:
            with self.subTest(file):
                self.check_outputs(file, torch.float64, 1e-8)

    def test_gradients(self) -> None:
        for file in SETS:
            reference = golden.read(file)
            with self.subTest(file):
                self.check_gradients(reference, reference["grads"], loss)
                only = reference["grads_value_only"]["grads"]
                self.check_gradients(reference, only, lambda output: output.values.sum())

    def check_gradients(self, reference, expected, objective) -> None:
        network = golden.network(reference).double()
        inputs = [x.double().requires_grad_() for x in golden.inputs(reference)]
        objective(network(*inputs)).backward()
        ours = dict(network.named_parameters())
        ours |= {f"in.{name}": x for name, x in zip(("nodes", "edges", "globals"), inputs)}
        for name, wanted in expected.items():
            gradient = ours[name].grad
            g = np.zeros(ours[name].numel()) if gradient is None else gradient.numpy().ravel()
            direction = golden.generate(f"dir.{name}", reference["info"]["seed"], g.size)
            largest, l2 = np.abs(g).max(), wanted["l2"]
            spread = l2 * math.sqrt(g.size)
            found = [
                ("l2", np.sqrt((g * g).sum()), l2),
                ("sum", g.sum(), spread),
                ("dot", g @ direction, spread),
                ("first", g[0], largest),
                ("last", g[-1], largest),
            ]
            for key, value, scale in found:
                if wanted.get(key) is not None:
                    off = abs(value - wanted[key])
                    self.assertLessEqual(off, TOLERANCE * scale, f"{key} of the gradient of {name} is {value}")


def unfolded(self: GraphLayer, nodes: torch.Tensor, edges: torch.Tensor, no_edge: torch.Tensor, embed) -> torch.Tensor:
    """Computes the residual as in the paper's listing: a query and a message for every edge."""
    c = self.config
    senders = nodes.unsqueeze(1).expand(-1, 16, -1, -1)
    pairs = torch.cat([senders, embed(edges)], -1)
    heads = lambda x: x.reshape(*x.shape[:-1], c.n_heads, c.head_dim)
    query, message, key = heads(self.query(pairs)), heads(self.message(pairs)), heads(self.key(nodes))
    logits = torch.einsum("brshd,brhd->brhs", query, key) / math.sqrt(c.head_dim)
    weights = torch.softmax(logits + no_edge, -1)
    return self.node_proj(torch.einsum("brhs,brshd->brhd", weights, message).flatten(2))


class Gaussian(Case):
    @classmethod
    def setUpClass(cls) -> None:
        cls.policy = golden.gaussian()

    def test_the_shipped_file_lists_the_parameters_in_this_order(self) -> None:
        policy = Policy.load(golden.PRETRAINED)
        table = [(entry["name"], entry["shape"]) for entry in policy.header["table"]]
        ours = [(name, list(value.shape)) for name, value in policy.network.state_dict().items()]
        self.assertEqual(ours, table)

    def test_folding_changes_nothing(self) -> None:
        """Compares float64 with the form that has a query and a message for every edge."""
        policy = golden.gaussian()
        inputs = scenes(policy, 3)
        network = policy.network.double()
        double = [x.double() for x in inputs]
        with torch.no_grad():
            output = network(*double)
            for layer in network.layers():
                layer.residual = lambda n, e, m, _, layer=layer: unfolded(layer, n, e, m, network.embed_edge)
            listing = network(*double)
        for name, ours, expected in zip(Output._fields, output, listing):
            self.assert_close(ours, expected, 1e-10, f"{name}, folded")
        for name, ours, expected in zip(Output._fields, plain(self.policy)(*inputs), listing):
            self.assert_close(ours, expected, TOLERANCE, f"{name}, in float32")

    def test_a_policy_goes_through_a_file(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "policy.safetensors"
            self.policy.save(path)
            again = Policy.load(path)
        self.assertEqual(again.header, self.policy.header)
        for name, value in self.policy.network.state_dict().items():
            self.assertTrue(torch.equal(again.network.state_dict()[name], value), name)

    def test_a_policy_gives_no_gradients(self) -> None:
        """The folded matrices would block gradients to half of the parameters."""
        self.assertFalse(self.policy(*scenes(self.policy, 1)).values.requires_grad)


class Mixture(Case):
    """The mixture head; test_same_policy.py compares it with Rust."""

    def proposals(self, b: int) -> Proposals:
        relations = np.abs(golden.generate("relations", 1, b * N_BLOCKS * N_BLOCKS * N_RELATION))
        relations = relations.reshape(b, N_BLOCKS, N_BLOCKS, N_RELATION).round(1)
        offered = golden.generate("offered", 1, b * N_BLOCKS * N_SLOTS).reshape(b, N_BLOCKS, N_SLOTS) > 0.0
        offered[..., -1] = True
        return Proposals(torch.from_numpy(relations.astype(np.float32)), torch.from_numpy(offered))

    def test_probabilities_of_all_draws_add_up(self) -> None:
        """Of the first gripper's and then of the second's, which also may choose the same block."""
        policy, proposals = golden.mixture(), self.proposals(1)
        output = policy(*scenes(policy, 1))

        def probabilities(*draws: Draw) -> torch.Tensor:
            n = len(draws[0].block)
            repeated = (type(x)(*(y.expand(n, *y.shape[1:]) for y in x)) for x in (output, proposals))
            return log_prob(*repeated, draws).exp()

        offered = proposals.offered[0].nonzero()
        alone = probabilities(Draw(*offered.T))
        self.assertAlmostEqual(alone.sum().item(), 1.0, delta=1e-5)
        for (block, slot), expected in list(zip(offered, alone))[::5]:
            second = Draw(*torch.cat([torch.stack([block, torch.tensor(-1)])[None], offered[offered[:, 0] != block]]).T)
            first = Draw(block.expand_as(second.block), slot.expand_as(second.slot))
            self.assertAlmostEqual(probabilities(first, second).sum().item(), expected.item(), delta=1e-5)

    def test_what_was_drawn_has_gradients(self) -> None:
        policy = golden.mixture()
        output = policy.network(*scenes(policy, 4))
        output.readouts.retain_grad()
        # The first gripper holds a block, holds another, joins one to the second gripper's, and detaches one from it.
        draws = [Draw(torch.tensor([0, 1, 2, 3]), torch.tensor([32, 32, 5, 16 + 6]))]
        draws.append(Draw(torch.tensor([4, 1, 5, 6]), torch.tensor([32, -1, 2, 16 + 3])))
        proposals = Proposals(self.proposals(4).relations, torch.ones(4, N_BLOCKS, N_SLOTS, dtype=torch.bool))
        log_prob(output, proposals, draws).sum().backward()
        self.assertTrue(torch.isfinite(output.readouts.grad).all())
        reached = parts_of(output.readouts.grad.abs().amax((0, 1)) > 0.0)
        missed = {name: (~part).nonzero().flatten().tolist() for name, part in reached.items() if not part.all()}
        # All but the biases of the partner of a held block, which has none.
        self.assertEqual(missed, {"mutual": [4, 5], "block_after": [7]})


class Settings(Case):
    """What a header can change."""

    def test_features_are_normalized_and_values_are_returns(self) -> None:
        policy = plain(golden.gaussian())
        c, inputs = policy.network.config, scenes(policy, 2)
        header = json.loads(json.dumps(policy.header))
        n = header["normalization"]
        n["feature_mean"], n["feature_std"] = (
            [[0.5] * c.node, [], [0.0] * c.global_],
            [[0.1] * c.node, [], [2.0] * c.global_],
        )
        n["value_mean"], n["value_std"] = 3.0, 2.0
        nodes, edges, globals_ = inputs
        nodes[0, 0, 0] = 9.0
        expected = policy(((nodes - 0.5) / 0.1).clamp(-10.0, 10.0), edges, globals_ / 2.0)
        ours = Policy(policy.network, header)(*inputs)
        self.assert_close(ours.logits, expected.logits, 1e-6, "logits")
        self.assert_close(ours.values, expected.values * 2.0 + 3.0, 1e-6, "values")

    def test_deviations_begin_where_they_are_set(self) -> None:
        """With all-zero parameters, the head's input is 0."""
        network = GraphNetwork(Config(init_std=0.3))
        output = network(torch.zeros(1, 16, 3), torch.zeros(1, 240, 24), torch.zeros(1, 50))
        torch.testing.assert_close(output.scales, torch.full((1, 16, 6), 0.3))
        paper = GraphNetwork(Config())(torch.zeros(1, 16, 3), torch.zeros(1, 240, 24), torch.zeros(1, 50))
        torch.testing.assert_close(paper.scales, torch.full((1, 16, 6), math.log(2.0) + 1e-6))

    def test_edges_are_where_the_network_looks_for_them(self) -> None:
        pairs = [(s, r) for s in range(16) for r in range(16)]
        edges = [(s, r) for s, r in pairs if s != r]
        dense = GraphNetwork(Config(edge=2)).dense_edges(torch.tensor([edges], dtype=torch.float32))[0]
        for s, r in pairs:
            self.assertEqual(dense[r, s].tolist(), [s, r] if s != r else [0, 0])

    def test_other_files_are_refused_by_name(self) -> None:
        policy = golden.gaussian()
        tensors = policy.network.state_dict()
        flat = json.loads(json.dumps(policy.header))
        swapped = json.loads(json.dumps(policy.header))
        places = [i for i, entry in enumerate(swapped["table"]) if entry["shape"] == swapped["table"][1]["shape"]]
        table = swapped["table"]
        table[places[0]], table[places[1]] = table[places[1]], table[places[0]]
        flat["policy"]["network"]["encoder"] = {"kind": "resnet", "hidden": 8, "n_blocks": 1}
        cases = [
            (tensors, {}, "no entry `lodestone`"),
            (tensors, {"lodestone": json.dumps({"format_version": 1})}, "format version is 1"),
            (tensors, {"lodestone": json.dumps(flat)}, "its encoder is `resnet`"),
            (tensors, {"lodestone": json.dumps(swapped)}, "its tensors are not those that were exported"),
            (
                {"embed_node.w": tensors["embed_node.w"]},
                {"lodestone": json.dumps(policy.header)},
                "no tensor embed_node.b",
            ),
        ]
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "other.safetensors"
            for values, metadata, reason in cases:
                save_file(dict(values), str(path), metadata=metadata)
                with self.assertRaisesRegex(ValueError, f"other.safetensors is not .*{reason}"):
                    Policy.load(path)
            path.write_bytes(b"no policy")
            for other in (path, path.with_name("missing.safetensors")):
                with self.assertRaisesRegex(ValueError, f"{other.name} is not"):
                    Policy.load(other)


if __name__ == "__main__":
    unittest.main()

"""Lodestone's policy as an ONNX graph, for runtimes that know neither Lodestone nor PyTorch.

    python lodestone_onnx.py policy.safetensors policy.onnx        # the first is what `lodestone export` writes

It needs the packages onnx and onnxscript besides those of lodestone_torch.py. The graph takes any number B of scenes:

| input | shape | meaning |
|---|---|---|
| nodes, edges, globals | [B, 16, nd], [B, 240, ed], [B, gd] | raw features |
| relations, offered | [B, 16, 16, 8], [B, 16, 33] bool | mixture head: the proposals |
| first | [B, 2] int64 | mixture head of two grippers: block and slot that the first one drew |

| output | shape | meaning |
|---|---|---|
| logits | [B, grippers, 16] | each gripper's choice of a block, without a mask |
| values | [B] | expected returns |
| locs, scales | [B, 16, 6] | Gaussian head: the moves |
| first_slots | [B, 16, 33] | mixture head: the first gripper's slots, for each block |
| second_blocks, second_slots | [B, 16], [B, 16, 33] | mixture head of two grippers: the second's, after `first` |
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import torch
from torch import Tensor, nn

from lodestone_torch import N_BLOCKS, N_RELATION, N_SLOTS, Draw, MixtureOutput, Policy, Proposals
from lodestone_torch import second_logits, slot_logits

# Number of scenes in the example that the exporter traces; the graph takes any other.
_EXAMPLES = 2


class Graph(nn.Module):
    """A policy with the inputs and outputs of the tables above, as flat tuples."""

    def __init__(self, policy: Policy):
        super().__init__()
        self.policy = policy
        c = policy.network.config
        has_second = c.mixture and c.n_grippers > 1
        self.inputs = {
            "nodes": torch.zeros(_EXAMPLES, N_BLOCKS, c.node),
            "edges": torch.zeros(_EXAMPLES, N_BLOCKS * (N_BLOCKS - 1), c.edge),
            "globals": torch.zeros(_EXAMPLES, c.global_),
        }
        self.outputs = ["logits", "values"]
        if c.mixture:
            self.inputs["relations"] = torch.zeros(_EXAMPLES, N_BLOCKS, N_BLOCKS, N_RELATION)
            self.inputs["offered"] = torch.ones(_EXAMPLES, N_BLOCKS, N_SLOTS, dtype=torch.bool)
            self.outputs += ["first_slots"]
        else:
            self.outputs += ["locs", "scales"]
        if has_second:
            self.inputs["first"] = torch.zeros(_EXAMPLES, 2, dtype=torch.int64)
            self.outputs += ["second_blocks", "second_slots"]

    def forward(
        self,
        nodes: Tensor,
        edges: Tensor,
        globals_: Tensor,
        relations: Tensor | None = None,
        offered: Tensor | None = None,
        first: Tensor | None = None,
    ) -> tuple[Tensor, ...]:
        output = self.policy(nodes, edges, globals_)
        if not isinstance(output, MixtureOutput):
            return output.logits, output.values, output.locs, output.scales
        proposals = Proposals(relations, offered)
        outputs = (output.logits, output.values, slot_logits(output, proposals))
        if first is None:
            return outputs
        draw = Draw(*first.unbind(-1))
        return *outputs, second_logits(output, proposals, draw), slot_logits(output, proposals, draw)


def export(policy: Policy, path: str | Path) -> None:
    """Writes the graph of a policy."""
    graph = Graph(policy).eval()
    torch.onnx.export(
        graph,
        tuple(graph.inputs.values()),
        path,
        input_names=list(graph.inputs),
        output_names=graph.outputs,
        dynamic_shapes=tuple({0: torch.export.Dim.DYNAMIC} for _ in graph.inputs),
        external_data=False,
        verbose=False,
    )


def main() -> None:
    """Converts a file."""
    parser = argparse.ArgumentParser(description="Writes an exported policy as an ONNX graph.")
    parser.add_argument("policy", help="what `lodestone export` wrote")
    parser.add_argument("graph", help="file to write")
    args = parser.parse_args()
    try:
        export(Policy.load(args.policy), args.graph)
    except (OSError, ValueError) as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()

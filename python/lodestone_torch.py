"""Lodestone's policy in PyTorch: the folded graph attention network, in one file.

    policy = Policy.load("policy.safetensors")              # what `lodestone export` writes
    logits, locs, scales, values = policy(nodes, edges, globals_)

`Policy` is for inference: it normalizes features and folds its parameters once. `GraphNetwork` is for training: it folds
in every forward pass, so gradients reach every parameter.

Shapes for a batch of B scenes, where `nd`, `ed`, and `gd` count the features listed in policy/src/features.rs:

| tensor | shape | meaning |
|---|---|---|
| nodes | [B, 16, nd] | features of the blocks |
| edges | [B, 240, ed] | features of pairs: for each sender, for each other block as the receiver |
| globals | [B, gd] | features of the grippers; each gripper's part ends with a one-hot of the block that it held |
| logits | [B, G, 16] | each gripper's choice of a block, not masked |
| locs, scales | [B, 16, 6] | mean and standard deviation of each block's move, in fractions of the speed limits |
| values | [B] | expected return |

With the mixture head (`policy.network.move_head = "mixture"`), each gripper draws a block, and then one of the block's
*slots*: the moves that `lodestone.proposals(env)` lists. The second gripper's logits depend on what the first one drew.
The outputs are logits, values, and readouts, and `Proposals` and `Draw` go in:

| tensor | shape | meaning |
|---|---|---|
| readouts | [B, 16, 121] | numbers of each block that the logits of slots are sums of |
| relations | [B, 16, 16, 8] | what the first block is to the second |
| offered | [B, 16, 33] | whether the block has a proposal in the slot |
| block, slot | [B] | what a gripper drew |

    output = policy(nodes, edges, globals_)
    slots = slot_logits(output, proposals)                        # [B, 16, 33]: of the first gripper, for each block
    first = Draw(block, slot)                                     # drawn from output.logits[:, 0] and slots[block]
    blocks = second_logits(output, proposals, first)              # [B, 16]: of the second gripper
    slots = slot_logits(output, proposals, first)                 # [B, 16, 33]: of the second gripper, for each block

Folding does not change the network: all maps between an edge and its attention are linear, so their matrices can be
multiplied together. They then act on 16 nodes instead of 240 edges (policy/src/network/gat.rs has the algebra).
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn
from torch.nn import functional as F

N_BLOCKS = 16
MOVE = 6
FORMAT_VERSION = 4
MAX_NORMALIZED = 10.0
LAYER_NORM_EPSILON = 1e-5
MIN_STD = 1e-6
NO_EDGE = -1e9
MASKED = -1e9
# Proposals: kinds with a partner (join, detach), all kinds (hold too), and length of a relation. Hold is the last slot.
N_PAIRED, N_KINDS, N_RELATION = 2, 3, 8
HOLD = N_PAIRED * N_BLOCKS
N_SLOTS = HOLD + 1
# Parts of a block's read-outs and their lengths: queries, keys, coefficients, and biases of the logits
# (policy/src/mixture.rs).
KEY = 16
READOUTS = {
    "slot_query": KEY,
    "slot_key": KEY,
    "paired": N_PAIRED * (N_RELATION + 1),
    "alone": N_KINDS - N_PAIRED,
    "after": N_KINDS * N_KINDS,
    "toward_first": N_KINDS * N_PAIRED,
    "mutual": N_KINDS * N_PAIRED,
    "block_query": KEY,
    "block_key": KEY,
    "block_relation": N_RELATION,
    "block_after": N_KINDS * 3,
}


class Output(NamedTuple):
    """The network's output for a batch. The tables above list the shapes."""

    logits: Tensor
    locs: Tensor
    scales: Tensor
    values: Tensor


class MixtureOutput(NamedTuple):
    """The output with the mixture head."""

    logits: Tensor
    values: Tensor
    readouts: Tensor


AnyOutput = Output | MixtureOutput


class Proposals(NamedTuple):
    """What a batch of scenes proposes. The table above lists the shapes."""

    relations: Tensor
    offered: Tensor


class Draw(NamedTuple):
    """A gripper's block and slot in each scene."""

    block: Tensor
    slot: Tensor

    def kind(self) -> Tensor:
        """Returns the kind, 0 to 2 [B]."""
        return self.slot // N_BLOCKS

    def partner(self) -> Tensor:
        """Returns the partner as a one-hot [B, 16], all zeros if the kind has none."""
        return F.one_hot(self.slot, N_SLOTS)[:, :HOLD].unflatten(-1, (N_PAIRED, N_BLOCKS)).sum(1).float()


class Folded(NamedTuple):
    """The edge path of one layer after folding: H heads, width w, `ed` edge features."""

    to_node: Tensor  # [w, H·w]: from a receiver to what its senders are compared with; empty without attention
    to_edge: Tensor  # [w, H·ed]: the same for its edges
    from_nodes: Tensor  # [H·w, w], or [w, w] without attention: from averaged senders to the residual
    from_edges: Tensor  # [H·ed, w], or [ed, w] without attention: from averaged edge features to the residual
    constant: Tensor  # [w]: the edge encoder's bias on its way to the residual


@dataclass(frozen=True)
class Config:
    """Feature and network sizes. The defaults are the paper's."""

    node: int = 3
    edge: int = 24
    global_: int = 50
    width: int = 64
    n_grippers: int = 2
    value_hidden: tuple[int, ...] = (512, 512, 512)
    attention: bool = True
    n_layers: int = 3
    n_heads: int = 4
    head_dim: int = 64
    mlp_hidden: int = 256
    init_std: float | None = None
    mixture: bool = False

    @classmethod
    def of(cls, header: dict[str, Any]) -> Config:
        """Reads the header of an exported policy. Raises ValueError if its encoder is not the graph network."""
        network = header["policy"]["network"]
        encoder = dict(network["encoder"])
        kind = encoder.pop("kind")
        if kind != "gat":
            raise ValueError(f"its encoder is `{kind}`; only `gat`, the graph network, is written here")
        shapes = {entry["name"]: entry["shape"] for entry in header["table"]}
        sizes = {name: shapes[f"embed_{name.rstrip('_')}.w"][0] for name in ("node", "edge", "global_")}
        rest = {"width": network["width"], "init_std": network["init_std"]}
        rest["n_grippers"] = header["policy"]["features"]["n_grippers"]
        # Files from before there was a choice have no such entry.
        rest["mixture"] = network.get("move_head", "gaussian") == "mixture"
        return cls(**sizes, **rest, **encoder, value_hidden=tuple(network["value_hidden"]))

    def scale_offset(self) -> float:
        """Returns the constant added before the softplus so that an input of 0 yields `init_std`."""
        if self.init_std is None:
            return 0.0
        return math.log(math.expm1(max(self.init_std - MIN_STD, 1e-6)))


def digest(table: list[dict[str, Any]], tensors: dict[str, Tensor]) -> str:
    """Returns the SHA-256 digest of names, shapes, and values in the order of the table (policy/src/parameters.rs)."""
    sha256 = hashlib.sha256()
    for entry in table:
        name, shape = entry["name"].encode(), entry["shape"]
        for part in (len(name).to_bytes(8, "little"), name, len(shape).to_bytes(8, "little")):
            sha256.update(part)
        for n in shape:
            sha256.update(n.to_bytes(8, "little"))
        sha256.update(tensors[entry["name"]].detach().float().contiguous().numpy().astype("<f4").tobytes())
    return sha256.hexdigest()


class Linear(nn.Module):
    """y = x w + b with a kernel [in, out], which is Lodestone's layout."""

    def __init__(self, n_in: int, n_out: int, bias: bool = True):
        super().__init__()
        self.w = nn.Parameter(torch.zeros(n_in, n_out))
        self.b = nn.Parameter(torch.zeros(n_out)) if bias else None

    def forward(self, x: Tensor) -> Tensor:
        return F.linear(x, self.w.t(), self.b)


class LayerNorm(nn.Module):
    """Normalizes the last axis, then scales and shifts it."""

    def __init__(self, width: int):
        super().__init__()
        self.scale = nn.Parameter(torch.ones(width))
        self.offset = nn.Parameter(torch.zeros(width))

    def forward(self, x: Tensor) -> Tensor:
        return F.layer_norm(x, self.scale.shape, self.scale, self.offset, LAYER_NORM_EPSILON)


def mlp(*widths: int) -> nn.ModuleList:
    return nn.ModuleList(Linear(a, b) for a, b in zip(widths, widths[1:]))


class GraphLayer(nn.Module):
    """Attention over each block's senders, then a per-node MLP and a scene MLP."""

    def __init__(self, c: Config):
        super().__init__()
        self.config = c
        inner = c.n_heads * c.head_dim
        self.message = Linear(2 * c.width, inner, bias=False)
        if c.attention:
            self.query = Linear(2 * c.width, inner, bias=False)
            self.key = Linear(c.width, inner, bias=False)
        self.node_proj = Linear(inner, c.width, bias=False)
        self.ln_attn = LayerNorm(c.width)
        self.mlp_node = mlp(2 * c.width, c.mlp_hidden, c.width)
        self.ln_mlp = LayerNorm(c.width)
        self.mlp_global = mlp(2 * c.width, c.mlp_hidden, c.width)
        self.ln_global = LayerNorm(c.width)

    def fold(self, embed_edge: Linear) -> Folded:
        """Multiplies together the matrices with no nonlinearity between them."""
        c = self.config

        def by_head(w: Tensor) -> Tensor:  # [w, H·d] -> [H, w, d]
            return w.reshape(c.width, c.n_heads, c.head_dim).transpose(0, 1)

        project = self.node_proj.w.reshape(c.n_heads, c.head_dim, c.width)
        from_nodes, from_embedded = (by_head(w) @ project for w in self.message.w.split(c.width))
        constant = embed_edge.b @ from_embedded.sum(0)
        from_edges = embed_edge.w @ from_embedded
        if not c.attention:
            # All heads compute the same average, so their projections add up.
            none = self.message.w.new_empty(0)
            return Folded(none, none, from_nodes.sum(0), from_edges.sum(0), constant)
        key = by_head(self.key.w) / math.sqrt(c.head_dim)
        to_node, to_embedded = (key @ by_head(w).transpose(1, 2) for w in self.query.w.split(c.width))
        to_edge = to_embedded @ embed_edge.w.t()
        return Folded(
            to_node.transpose(0, 1).flatten(1),
            to_edge.transpose(0, 1).flatten(1),
            from_nodes.flatten(0, 1),
            from_edges.flatten(0, 1),
            constant,
        )

    def attend(self, nodes: Tensor, edges: Tensor, no_edge: Tensor, folded: Folded) -> Tensor:
        """Returns the attention weights [B, 16 receivers, H, 16 senders]."""
        c, ed = self.config, edges.shape[-1]
        by_node = (nodes @ folded.to_node).reshape(-1, N_BLOCKS * c.n_heads, c.width)
        by_edge = (nodes @ folded.to_edge).reshape(-1, N_BLOCKS, c.n_heads, ed)
        logits = (by_node @ nodes.transpose(1, 2)).reshape(-1, N_BLOCKS, c.n_heads, N_BLOCKS)
        return torch.softmax(logits + by_edge @ edges.transpose(2, 3) + no_edge, -1)

    def residual(self, nodes: Tensor, edges: Tensor, no_edge: Tensor, folded: Folded) -> Tensor:
        """Returns the edges' contribution to each node, [B, 16, w]."""
        c, ed = self.config, edges.shape[-1]
        if c.attention:
            weights = self.attend(nodes, edges, no_edge, folded)
            mean_nodes = weights.reshape(-1, N_BLOCKS * c.n_heads, N_BLOCKS) @ nodes
            mean_nodes = mean_nodes.reshape(-1, N_BLOCKS, c.n_heads * c.width)
            mean_edges = (weights @ edges).reshape(-1, N_BLOCKS, c.n_heads * ed)
        else:
            n_senders = N_BLOCKS - 1
            mean_nodes = (nodes.sum(1, keepdim=True) - nodes) / n_senders
            mean_edges = edges.sum(2) / n_senders
        return mean_nodes @ folded.from_nodes + mean_edges @ folded.from_edges + folded.constant

    def forward(
        self, nodes: Tensor, scene: Tensor, edges: Tensor, no_edge: Tensor, folded: Folded
    ) -> tuple[Tensor, Tensor]:
        """nodes [B, 16, w], scene [B, w], edges [B, 16 receivers, 16 senders, ed] -> the new nodes and scene."""
        y = self.ln_attn(nodes + self.residual(nodes, edges, no_edge, folded))
        # The scene's half of the first layer is computed once per scene, not once per node.
        first, second = self.mlp_node
        on_node, on_scene = first.w.split(self.config.width)
        shared = scene @ on_scene + first.b
        nodes = self.ln_mlp(second(torch.relu(y @ on_node + shared.unsqueeze(1))) + y)
        first, second = self.mlp_global
        hidden = torch.relu(first(torch.cat([scene, nodes.sum(1)], -1)))
        return nodes, self.ln_global(second(hidden) + scene)


class PolicyHead(nn.Module):
    """Maps nodes and scene to what actions are drawn from."""

    def __init__(self, c: Config):
        super().__init__()
        self.config = c
        self.input_global = Linear(c.global_, c.width, bias=False)
        if not c.mixture:
            self.act_loc = Linear(c.width, MOVE)
            self.act_scale = Linear(c.width, MOVE)
        self.grip_key = Linear(2 * c.width, c.n_grippers * c.width, bias=False)
        self.block_key = Linear(c.width + c.n_grippers, c.width, bias=False)
        if c.mixture:
            self.proposals = Linear(c.width, sum(READOUTS.values()))

    def forward(self, nodes: Tensor, scene: Tensor, raw: Tensor) -> Tensor:
        """nodes [B, 16, w], scene [B, w], features of the scene [B, gd] -> logits."""
        c = self.config
        grip = self.grip_key(torch.cat([self.input_global(raw), scene], -1)).reshape(-1, c.n_grippers, c.width)
        held = raw.reshape(-1, c.n_grippers, c.global_ // c.n_grippers)[:, :, -N_BLOCKS:].transpose(1, 2)
        keys = self.block_key(torch.cat([nodes, held], -1))
        return grip @ keys.transpose(1, 2) / math.sqrt(c.width)

    def moves(self, nodes: Tensor) -> tuple[Tensor, Tensor]:
        """nodes [B, 16, w] -> locs, scales."""
        c = self.config
        return self.act_loc(nodes), F.softplus(self.act_scale(nodes) + c.scale_offset()) + MIN_STD


class ValueHead(nn.Module):
    """Maps the scene and the block choice probabilities to the value."""

    def __init__(self, c: Config):
        super().__init__()
        self.input_global = Linear(c.global_, c.width, bias=False)
        self.graph_global = Linear(c.width, c.width, bias=False)
        self.mlp = mlp(2 * c.width + c.n_grippers * N_BLOCKS, *c.value_hidden, 1)

    def forward(self, scene: Tensor, raw: Tensor, logits: Tensor) -> Tensor:
        """scene [B, w], features of the scene [B, gd], logits [B, G, 16] -> [B]."""
        # Detached so that the value loss does not influence the choice of blocks.
        choice = torch.softmax(logits.detach(), -1).flatten(1)
        x = torch.cat([self.input_global(raw), self.graph_global(scene), choice], -1)
        for j, layer in enumerate(self.mlp):
            x = layer(torch.relu(x) if j else x)
        return x.squeeze(-1)


class GraphNetwork(nn.Module):
    """The actor-critic network. `state_dict()` has the file's names and order. Linear parameters start at 0."""

    def __init__(self, config: Config):
        super().__init__()
        c = self.config = config
        self.embed_node = Linear(c.node, c.width)
        self.embed_edge = Linear(c.edge, c.width)
        self.embed_global = Linear(c.global_, c.width)
        for n in range(c.n_layers):
            self.add_module(f"layer{n}", GraphLayer(c))
        self.head = PolicyHead(c)
        self.value = ValueHead(c)
        diagonal = torch.eye(N_BLOCKS, dtype=torch.bool)
        no_edge = torch.zeros(N_BLOCKS, N_BLOCKS).masked_fill(diagonal, NO_EDGE)
        self.register_buffer("no_edge", no_edge.reshape(1, N_BLOCKS, 1, N_BLOCKS), persistent=False)
        self.register_buffer("listed", listed(), persistent=False)

    def layers(self) -> list[GraphLayer]:
        return [self.get_submodule(f"layer{n}") for n in range(self.config.n_layers)]

    def fold(self) -> list[Folded]:
        """Computes the matrices that depend on parameters only. They are valid until the parameters change."""
        return [layer.fold(self.embed_edge) for layer in self.layers()]

    def dense_edges(self, edges: Tensor) -> Tensor:
        """[B, 240, ed] -> [B, 16 receivers, 16 senders, ed], zeros where both are the same block."""
        dense = F.pad(edges, (0, 0, 0, 1)).index_select(1, self.listed)
        return dense.reshape(-1, N_BLOCKS, N_BLOCKS, edges.shape[-1])

    def forward(self, nodes: Tensor, edges: Tensor, globals_: Tensor, folded: list[Folded] | None = None) -> AnyOutput:
        """Normalized features -> output. The values are normalized like the training targets."""
        return self.forward_dense(nodes, self.dense_edges(edges), globals_, folded)

    def forward_dense(self, nodes: Tensor, edges: Tensor, raw: Tensor, folded: list[Folded] | None = None) -> AnyOutput:
        """Like `forward`, but takes edges in the format that `dense_edges` returns."""
        n, g = self.embed_node(nodes), self.embed_global(raw)
        for layer, matrices in zip(self.layers(), folded or self.fold()):
            n, g = layer(n, g, edges, self.no_edge, matrices)
        logits = self.head(n, g, raw)
        values = self.value(g, raw, logits)
        if self.config.mixture:
            return MixtureOutput(logits, values, self.head.proposals(n))
        return Output(logits, *self.head.moves(n), values)


def listed() -> Tensor:
    """Returns the index of the edge to receiver i from sender j in the edge list, for each i, for each j: [256].

    The list has no edge from a block to itself, which gets the index just past its end, where `dense_edges` pads with
    zeros.
    """
    n = N_BLOCKS

    def at(sender: int, receiver: int) -> int:
        if sender == receiver:
            return n * (n - 1)
        return sender * (n - 1) + receiver - (receiver > sender)

    return torch.tensor([at(sender, receiver) for receiver in range(n) for sender in range(n)])


def parts_of(readouts: Tensor) -> dict[str, Tensor]:
    """Splits read-outs [..., 121] by `READOUTS`."""
    return dict(zip(READOUTS, readouts.split(list(READOUTS.values()), -1)))


def at_block(values: Tensor, block: Tensor) -> Tensor:
    """[B, 16, ...], [B] -> [B, ...]."""
    index = block.reshape(-1, *[1] * (values.dim() - 1)).expand(-1, 1, *values.shape[2:])
    return values.gather(1, index).squeeze(1)


def at_kind(values: Tensor, kind: Tensor) -> Tensor:
    """[B, ..., 3 · n], [B] -> [B, ..., n]."""
    values = values.unflatten(-1, (N_KINDS, -1))
    chosen = F.one_hot(kind, N_KINDS).to(values.dtype)
    return (values * chosen.reshape(-1, *[1] * (values.dim() - 3), N_KINDS, 1)).sum(-2)


def slot_logits(output: MixtureOutput, proposals: Proposals, first: Draw | None = None) -> Tensor:
    """Returns the logits of each block's slots [B, 16, 33], for the first gripper or, after `first`, for the second.

    What is not offered has the logit -1e9. A second gripper that chose the first one's block draws no slot.
    """
    part = parts_of(output.readouts)
    coefficients = part["paired"].unflatten(-1, (N_PAIRED, N_RELATION + 1))
    paired = coefficients[..., :-1] @ proposals.relations.transpose(2, 3) + coefficients[..., -1:]
    paired = paired + (part["slot_query"] @ part["slot_key"].transpose(1, 2) / math.sqrt(KEY)).unsqueeze(2)
    alone = part["alone"]
    if first is not None:
        after, toward, mutual = (at_kind(part[name], first.kind()) for name in ("after", "toward_first", "mutual"))
        # Toward the first gripper's block, and if that comes here as well.
        toward = toward + mutual * first.partner().to(mutual.dtype).unsqueeze(-1)
        is_first = F.one_hot(first.block, N_BLOCKS).to(toward.dtype)
        paired = paired + after[..., :N_PAIRED, None] + toward.unsqueeze(-1) * is_first[:, None, None]
        alone = alone + after[..., N_PAIRED:]
    return torch.cat([paired.flatten(2), alone], -1).masked_fill(~proposals.offered, MASKED)


def second_logits(output: MixtureOutput, proposals: Proposals, first: Draw) -> Tensor:
    """Returns the logits of the second gripper's block [B, 16], after the first gripper's draw."""
    own = parts_of(at_block(output.readouts, first.block))
    keys, relations = parts_of(output.readouts)["block_key"], at_block(proposals.relations, first.block)
    same_block, its_partner, same_piece = at_kind(own["block_after"], first.kind()).split(1, -1)
    others = (keys @ own["block_query"].unsqueeze(-1)).squeeze(-1) / math.sqrt(KEY)
    others = others + (relations @ own["block_relation"].unsqueeze(-1)).squeeze(-1)
    # Entry 1 of a relation: in one piece.
    others = others + its_partner * first.partner().to(others.dtype) + same_piece * (relations[..., 1] != 0)
    return output.logits[:, 1] + torch.where(F.one_hot(first.block, N_BLOCKS) == 1, same_block, others)


def log_prob(output: MixtureOutput, proposals: Proposals, draws: Sequence[Draw]) -> Tensor:
    """Returns the log-probability [B] in nats of all grippers' draws.

    Slot -1 says that the second gripper chose the first one's block. The noise around a proposal has no parameters and
    is left out. Logits of blocks that may not be chosen are to be -1e9.
    """
    total = torch.zeros_like(output.values)
    for gripper, draw in enumerate(draws):
        first = draws[0] if gripper else None
        blocks = second_logits(output, proposals, first) if first else output.logits[:, 0]
        total = total + at_block(torch.log_softmax(blocks, -1), draw.block)
        slots = torch.log_softmax(at_block(slot_logits(output, proposals, first), draw.block), -1)
        total = total + torch.where(draw.slot >= 0, at_block(slots, draw.slot.clamp(min=0)), 0.0)
    return total


class Policy(nn.Module):
    """A policy for inference. Takes raw features and returns values in units of return.

    Parameters are folded once and receive no gradients. After training `network`, create a new policy with the same
    header: `Policy(network, policy.header)`.
    """

    def __init__(self, network: GraphNetwork, header: dict[str, Any]):
        super().__init__()
        self.network = network
        self.header = header
        normalization = header["normalization"]
        self.value_mean, self.value_std = normalization["value_mean"], normalization["value_std"]
        sizes = (network.config.node, network.config.edge, network.config.global_)
        for k, size in enumerate(sizes):
            # Features without statistics are not normalized.
            mean, std = (
                normalization["feature_mean"][k] or [0.0] * size,
                normalization["feature_std"][k] or [1.0] * size,
            )
            limit = MAX_NORMALIZED if normalization["feature_mean"][k] else math.inf
            for name, value in (("mean", mean), ("std", std), ("limit", limit)):
                self.register_buffer(f"{name}{k}", torch.tensor(value, dtype=torch.float32), persistent=False)
        with torch.no_grad():
            for n, matrices in enumerate(network.fold()):
                for name, value in matrices._asdict().items():
                    self.register_buffer(f"folded{n}_{name}", value, persistent=False)
        self.eval()

    @classmethod
    def load(cls, path: str | Path) -> Policy:
        """Reads a file written by `lodestone export`. Raises ValueError with the file name if it is not a policy."""
        try:
            with safe_open(str(path), framework="pt") as file:
                entry = (file.metadata() or {}).get("lodestone")
                tensors = {name: file.get_tensor(name) for name in file.keys()}
            if entry is None:
                raise ValueError("its metadata has no entry `lodestone`; write one with `lodestone export`")
            header = json.loads(entry)
            if header["format_version"] != FORMAT_VERSION:
                raise ValueError(f"its format version is {header['format_version']}, this module reads {FORMAT_VERSION}")
            network = GraphNetwork(Config.of(header))
            for name, value in network.state_dict().items():
                if name not in tensors or tensors[name].shape != value.shape:
                    raise ValueError(f"it has no tensor {name} of shape {list(value.shape)}")
            if header["digest"] != digest(header["table"], tensors):
                raise ValueError("its tensors are not those that were exported: their digest is another")
            network.load_state_dict(tensors)
        except (OSError, SafetensorError, KeyError, TypeError, RuntimeError, ValueError) as error:
            raise ValueError(f"{path} is not a policy that this module reads: {error}") from error
        return cls(network, header)

    def save(self, path: str | Path) -> None:
        """Writes a file that Lodestone can read, for example with `lodestone eval --checkpoint FILE`."""
        tensors = {name: value.float().contiguous() for name, value in self.network.state_dict().items()}
        header = {**self.header, "digest": digest(self.header["table"], tensors)}
        save_file(tensors, str(path), metadata={"lodestone": json.dumps(header, separators=(",", ":"))})

    def folded(self) -> list[Folded]:
        """Returns the folded matrices of each layer."""
        layers = range(self.network.config.n_layers)
        return [Folded(*(getattr(self, f"folded{n}_{name}") for name in Folded._fields)) for n in layers]

    @torch.no_grad()
    def forward(self, nodes: Tensor, edges: Tensor, globals_: Tensor) -> AnyOutput:
        """Raw features, as listed in policy/src/features.rs -> output."""
        features = []
        for k, x in enumerate((nodes, edges, globals_)):
            mean, std, limit = (getattr(self, f"{name}{k}") for name in ("mean", "std", "limit"))
            features.append(((x - mean) / std).clamp(-limit, limit))
        output = self.network(*features, self.folded())
        return output._replace(values=output.values * self.value_std + self.value_mean)

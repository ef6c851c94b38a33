"""Reads the network's reference values and generates the matching parameters and inputs.

policy/tests/golden/README.md explains their origin. `generate` mirrors the function of the same name in
policy/tests/reference/common.rs.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import torch

ROOT = Path(__file__).parents[2]
# Appended after the installed packages: this folder also holds the sources of `lodestone` without the native module.
sys.path.append(str(ROOT / "python"))

from lodestone_torch import Config, GraphNetwork, Policy, digest

GOLDEN = ROOT / "policy/tests/golden"
PRETRAINED = ROOT / "deploy/pretrained/model.safetensors"
# Names of the outputs in the golden files, in the order of `Output`.
OUTPUTS = ("grip_logits", "block_act_locs", "block_act_scales", "value")
_RATIO, _ALL = 0x9E3779B97F4A7C15, (1 << 64) - 1


def read(name: str) -> dict[str, Any]:
    return json.loads((GOLDEN / name).read_text())


def generate(name: str, seed: int, n: int) -> np.ndarray:
    """Returns `n` float64 numbers in [-1, 1), exactly representable in float32, for a tensor name and a seed."""
    h = 0xCBF29CE484222325
    for byte in name.encode():
        h = (h ^ byte) * 0x100000001B3 & _ALL
    start = (h ^ seed * _RATIO) & _ALL
    with np.errstate(over="ignore"):
        z = np.uint64(start) + np.arange(1, n + 1, dtype=np.uint64) * np.uint64(_RATIO)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z ^= z >> np.uint64(31)
    return (z >> np.uint64(40)).astype(np.float64) / 2.0**23 - 1.0


def network(golden: dict[str, Any]) -> GraphNetwork:
    """Builds the network of a golden file in float32."""
    info = golden["info"]
    sizes = {"node": info["node_dim"], "edge": info["edge_dim"], "global_": info["global_dim"]}
    made = GraphNetwork(Config(**sizes, attention=info["kind"] == "gat"))
    shapes = {name: list(value.shape) for name, value in made.state_dict().items()}
    assert shapes == golden["shapes"], "names and shapes of the parameters"
    values = {}
    for name, shape in shapes.items():
        x = generate(f"param.{name}", info["seed"], int(np.prod(shape)))
        match name.rsplit(".", 1)[1]:
            case "w":
                x = min(0.5, 2.5 / np.sqrt(shape[0])) * x
            case "scale":
                x = 1.0 + 0.5 * x
            case _:
                x = 0.5 * x
        x = x.astype(np.float32)
        first = golden["param_check"][name]["first"]
        assert x[: len(first)].tolist() == first, f"generator at {name}"
        values[name] = torch.from_numpy(x.reshape(shape))
    made.load_state_dict(values)
    return made


def inputs(golden: dict[str, Any]) -> list[torch.Tensor]:
    """Generates the nodes, edges, and globals of a golden file in float32."""
    info = golden["info"]
    b, seed = info["batch"], info["seed"]

    def make(name: str, *shape: int) -> np.ndarray:
        return (1.5 * generate(f"in.{name}", seed, int(np.prod(shape)))).astype(np.float32).reshape(shape)

    made = {
        "nodes": make("nodes", b, 16, info["node_dim"]),
        "edges": make("edges", b, info["n_edge"], info["edge_dim"]),
        "globals": make("globals", b, info["global_dim"]),
    }
    held = made["globals"].reshape(b, 2, -1)[:, :, -16:]
    held[:] = 0.0
    for item in range(b):
        for gripper in range(2):
            if (item, gripper) != (1, 1):
                held[item, gripper, (3 * item + 5 * gripper + 1) % 16] = 1.0
    for name, x in made.items():
        first = golden["input_check"][name]
        assert x.ravel()[: len(first)].tolist() == first, f"generator at in.{name}"
    return [torch.from_numpy(x) for x in made.values()]


def mixture(n_grippers: int = 2) -> Policy:
    """Makes a small policy with the mixture head, the paper's features, and parameters that nothing was learned from."""
    return _untrained({"node": 3, "edge": 24, "global_": 25 * n_grippers, "n_grippers": n_grippers}, True)


def gaussian() -> Policy:
    """Makes a small policy with the Gaussian head, all features, and parameters that nothing was learned from."""
    return _untrained({"node": 10, "edge": 36, "global_": 50, "n_grippers": 2}, False)


def native(policy: Policy, action: str = "native") -> Any:
    """Takes a policy to Rust, through a file."""
    import lodestone

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "policy.safetensors")
        policy.save(path)
        return lodestone.Policy.load(path, action)


def _untrained(sizes: dict[str, int], is_mixture: bool) -> Policy:
    encoder = {"attention": True, "n_layers": 2, "n_heads": 2, "head_dim": 8, "mlp_hidden": 32}
    made = GraphNetwork(Config(**sizes, **encoder, width=32, value_hidden=(16,), mixture=is_mixture))
    with torch.no_grad():
        for name, value in made.named_parameters():
            numbers = generate(name, 1, value.numel()).reshape(value.shape)
            value += torch.from_numpy(numbers * min(0.5, 2.0 / np.sqrt(value.shape[0])))
    n_grippers = sizes["n_grippers"]
    network = {"encoder": {"kind": "gat", **encoder}, "width": 32, "value_hidden": [16], "init_std": None}
    network |= {"move_head": "mixture"} if is_mixture else {}
    flags = ("up_axis", "membership", "block_shape", "needed_moves")
    features = {**dict.fromkeys(flags, not is_mixture), "n_grippers": n_grippers}
    policy = {"network": network, "features": features, "mask": "blueprint" if is_mixture else "none"}
    table = [{"name": name, "shape": list(value.shape)} for name, value in made.state_dict().items()]
    header = {
        "format_version": 4,
        "weights_version": 7,
        "n_env_steps": 0,
        "policy": policy,
        "settings": [],
        "digest": digest(table, made.state_dict()),
        "table": table,
        "normalization": {"feature_mean": [[]] * 3, "feature_std": [[]] * 3, "value_mean": 1.0, "value_std": 2.0},
    }
    return Policy(made, header)

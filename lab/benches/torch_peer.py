"""Times the paper's network in eager PyTorch on the CPU, folded as in `policy`, and prints samples per CPU-second.

The network is the module python/lodestone_torch.py. Besides the speeds, it prints what bounds them: how fast this core
multiplies two 512 x 512 matrices, and the matrix-product operations per sample, with the paper's features and with the
learner's default features. Run by lab/benches/peers.py.
"""

import sys
from pathlib import Path

import torch
from torch.utils.flop_counter import FlopCounterMode

sys.path.insert(0, str(Path(__file__).parents[2] / "python"))

import peer
from lodestone_torch import Config, GraphNetwork

# Feature counts of `policy::FeatureConfig::paper` and `::default`.
SIZES = {"paper": (peer.ND, peer.ED, peer.GD), "default": (10, 36, 50)}


def network(sizes):
    """Returns a network with random kernels."""
    torch.manual_seed(0)
    made = GraphNetwork(Config(*sizes))
    with torch.no_grad():
        for name, value in made.named_parameters():
            if name.endswith(".w"):
                value.normal_(std=value.shape[0] ** -0.5)
    return made


def batch(sizes, b):
    """Returns random nodes, edges from all senders to all receivers, and globals."""
    nd, ed, gd = sizes
    return torch.rand(b, peer.N, nd), torch.rand(b, peer.N, peer.N, ed), torch.rand(b, gd)


def forward(made, folded, inputs):
    with torch.no_grad():
        made.forward_dense(*inputs, folded)


def update(made, inputs):
    """Computes the gradients of the loss used for the reference values."""
    logits, locs, scales, values = made.forward_dense(*inputs)
    loss = values.sum() + logits.square().sum() + locs.square().sum() + scales.log().sum()
    torch.autograd.grad(loss, list(made.parameters()))


def count(work):
    """Counts the operations of the matrix products in `work`. A multiply-add counts as two."""
    with FlopCounterMode(display=False) as counter:
        work()
    return counter.get_total_flops()


def main():
    torch.set_num_threads(1)
    print(f"version {torch.__version__.split('+')[0]}")
    for name, sizes in SIZES.items():
        made, inputs, b = network(sizes), batch(sizes, 256), 256
        folded = made.fold()
        print(f"operations forward {name} {count(lambda: forward(made, folded, inputs)) / b:.0f}")
        print(f"operations update {name} {count(lambda: update(made, inputs)) / b:.0f}")
    x, y = torch.rand(512, 512), torch.rand(512, 512)
    print(f"sgemm 512 {2 * 512**3 / peer.best(lambda: x @ y, 4) / 1e9:.1f} GFLOP/s")
    made = network(SIZES["paper"])
    with torch.no_grad():
        folded = made.fold()
    for kind, b in peer.CASES:
        inputs = batch(SIZES["paper"], b)
        peer.report(kind, b, lambda: forward(made, folded, inputs) if kind == "forward" else update(made, inputs))


if __name__ == "__main__":
    main()

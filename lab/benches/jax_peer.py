"""Times the paper's network in JAX on the CPU, folded as in `policy`, and prints samples per CPU-second.

Run by lab/benches/peers.py.
"""

import os

os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ["JAX_PLATFORMS"] = "cpu"

import jax
import jax.numpy as jnp

import peer
from peer import ED, GD, N, ND

W, H, HIDDEN = 64, 4, 256


def init(key):
    shapes = {"en": (ND, W), "ee": (ED, W), "eg": (GD, W)}
    for l in range(3):
        shapes |= {
            f"m{l}": (2 * W, H * W), f"q{l}": (2 * W, H * W), f"k{l}": (W, H * W), f"o{l}": (H * W, W),
            f"n0{l}": (2 * W, HIDDEN), f"n1{l}": (HIDDEN, W), f"g0{l}": (2 * W, HIDDEN), f"g1{l}": (HIDDEN, W),
        }
    shapes |= {
        "hg": (GD, W), "loc": (W, 6), "scale": (W, 6), "grip": (2 * W, 2 * W), "block": (W + 2, W),
        "vg": (GD, W), "vgg": (W, W), "v0": (2 * W + 32, 512), "v1": (512, 512), "v2": (512, 512), "v3": (512, 1),
    }
    keys = jax.random.split(key, len(shapes))
    p = {n: jax.random.normal(k, s) / s[0] ** 0.5 for k, (n, s) in zip(keys, shapes.items())}
    biased = ["en", "ee", "eg", "loc", "scale", "v0", "v1", "v2", "v3"]
    biased += [f"{n}{l}" for l in range(3) for n in ("n0", "n1", "g0", "g1")]
    p |= {n + "_b": jnp.zeros(shapes[n][1]) for n in biased}
    p |= {f"ln{k}{l}_{part}": v * jnp.ones(W) for k in range(3) for l in range(3) for part, v in (("s", 1.0), ("o", 0.0))}
    return p


def linear(p, n, x):
    return x @ p[n] + p[n + "_b"]


def norm(p, n, x):
    mean = x.mean(-1, keepdims=True)
    var = ((x - mean) ** 2).mean(-1, keepdims=True)
    return (x - mean) * jax.lax.rsqrt(var + 1e-5) * p[n + "_s"] + p[n + "_o"]


def fold(p):
    heads = lambda w: w.reshape(W, H, W).transpose(1, 0, 2)
    out = []
    for l in range(3):
        key = heads(p[f"k{l}"]) / 8.0
        to_node = (key @ heads(p[f"q{l}"][:W]).transpose(0, 2, 1)).transpose(1, 0, 2).reshape(W, H * W)
        to_edge = key @ heads(p[f"q{l}"][W:]).transpose(0, 2, 1) @ p["ee"].T
        o = p[f"o{l}"].reshape(H, W, W)
        message = heads(p[f"m{l}"][W:]) @ o
        out.append((
            to_node, to_edge.transpose(1, 0, 2).reshape(W, H * ED), (heads(p[f"m{l}"][:W]) @ o).reshape(H * W, W),
            (p["ee"] @ message).reshape(H * ED, W), p["ee_b"] @ message.sum(0),
        ))
    return out


def forward(p, folded, nodes, edges, raw):
    """nodes [B,16,ND], edges [B,16 receivers,16 senders,ED], raw [B,GD]."""
    b = raw.shape[0]
    n, g = linear(p, "en", nodes), linear(p, "eg", raw)
    mask = jnp.where(jnp.eye(N, dtype=bool), -1e9, 0.0)[None, :, None, :]
    for l, (to_node, to_edge, from_nodes, from_edges, constant) in enumerate(folded):
        a = (n @ to_node).reshape(b, N * H, W)
        c = (n @ to_edge).reshape(b, N, H, ED)
        logits = (a @ n.transpose(0, 2, 1)).reshape(b, N, H, N) + c @ edges.transpose(0, 1, 3, 2) + mask
        w = jax.nn.softmax(logits, -1)
        u = (w.reshape(b, N * H, N) @ n).reshape(b, N, H * W)
        v = (w @ edges).reshape(b, N, H * ED)
        y = norm(p, f"ln0{l}", n + u @ from_nodes + v @ from_edges + constant)
        shared = g @ p[f"n0{l}"][W:] + p[f"n0{l}_b"]
        h = jax.nn.relu(y @ p[f"n0{l}"][:W] + shared[:, None])
        n = norm(p, f"ln1{l}", linear(p, f"n1{l}", h) + y)
        h = jax.nn.relu(linear(p, f"g0{l}", jnp.concatenate([g, n.sum(1)], -1)))
        g = norm(p, f"ln2{l}", linear(p, f"g1{l}", h) + g)
    locs, scales = linear(p, "loc", n), jax.nn.softplus(linear(p, "scale", n)) + 1e-6
    grip = (jnp.concatenate([raw @ p["hg"], g], -1) @ p["grip"]).reshape(b, 2, W)
    held = raw.reshape(b, 2, GD // 2)[:, :, -N:].transpose(0, 2, 1)
    keys = jnp.concatenate([n, held], -1) @ p["block"]
    logits = grip @ keys.transpose(0, 2, 1) / 8.0
    choice = jax.lax.stop_gradient(jax.nn.softmax(logits, -1)).reshape(b, 2 * N)
    x = jnp.concatenate([raw @ p["vg"], g @ p["vgg"], choice], -1)
    for j in range(4):
        x = linear(p, f"v{j}", x if j == 0 else jax.nn.relu(x))
    return locs, scales, logits, x[:, 0]


def loss(p, *batch):
    locs, scales, logits, value = forward(p, fold(p), *batch)
    return value.sum() + (logits**2).sum() + (locs**2).sum() + jnp.log(scales).sum()


def main():
    print(f"version {jax.__version__}")
    p = init(jax.random.key(0))
    folded = jax.jit(fold)(p)
    run, grad = jax.jit(forward), jax.jit(jax.grad(loss))
    for kind, b in peer.CASES:
        k = jax.random.split(jax.random.key(b), 3)
        batch = [jax.random.uniform(k[0], (b, N, ND)), jax.random.uniform(k[1], (b, N, N, ED)), jax.random.uniform(k[2], (b, GD))]
        work = (lambda: run(p, folded, *batch)) if kind == "forward" else (lambda: grad(p, *batch))
        peer.report(kind, b, lambda: jax.block_until_ready(work()))


if __name__ == "__main__":
    main()

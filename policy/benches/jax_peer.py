"""The paper's network in folded form in jax on the CPU, timed beside this crate's own bench.

Usage: pip install jax; cargo build --release -p policy --benches; python policy/benches/jax_peer.py BENCH_BINARY
BENCH_BINARY is the `network` bench; called with `--json` it prints one JSON object: case name -> samples per CPU-second.
Each case is run several times in turn with the other side's; the best of each counts. Prints the ratio ours / jax.
"""

import json
import resource
import subprocess
import sys
import time

import jax
import jax.numpy as jnp
import numpy as np

N, HEADS, D, LAYERS, GRIPPERS, ACT = 16, 4, 64, 3, 2, 6


def init(rng, nd, ed, gd):
    """Parameters as a dict of arrays named as in the crate's parameter table; kernels are [in, out]."""
    p = {}

    def lin(name, i, o, bias=True):
        p[name + ".w"] = rng.normal(0, i**-0.5, (i, o))
        if bias:
            p[name + ".b"] = np.zeros(o)

    def norm(name):
        p[name + ".scale"], p[name + ".offset"] = np.ones(D), np.zeros(D)

    lin("embed_node", nd, D)
    lin("embed_edge", ed, D)
    lin("embed_global", gd, D)
    for l in range(LAYERS):
        lin(f"l{l}.message", 2 * D, HEADS * D, False)
        lin(f"l{l}.query", 2 * D, HEADS * D, False)
        lin(f"l{l}.key", D, HEADS * D, False)
        lin(f"l{l}.node_proj", HEADS * D, D, False)
        for part in ("node", "global"):
            lin(f"l{l}.mlp_{part}.0", 2 * D, 4 * D)
            lin(f"l{l}.mlp_{part}.1", 4 * D, D)
        for n in ("attn", "mlp", "global"):
            norm(f"l{l}.ln_{n}")
    lin("head.input_global", gd, D, False)
    lin("head.act_loc", D, ACT)
    lin("head.act_scale", D, ACT)
    lin("head.grip_key", 2 * D, GRIPPERS * D, False)
    lin("head.block_key", D + GRIPPERS, D, False)
    lin("value.input_global", gd, D, False)
    lin("value.graph_global", D, D, False)
    sizes = [2 * D + GRIPPERS * N, 512, 512, 512, 1]
    for j in range(4):
        lin(f"value.mlp.{j}", sizes[j], sizes[j + 1])
    return {k: jnp.asarray(v, jnp.float32) for k, v in p.items()}


def layer_norm(p, name, x):
    mean = x.mean(-1, keepdims=True)
    var = ((x - mean) ** 2).mean(-1, keepdims=True)
    return (x - mean) * jax.lax.rsqrt(var + 1e-5) * p[name + ".scale"] + p[name + ".offset"]


def mlp(p, name, x, n):
    for j in range(n):
        x = x @ p[f"{name}.{j}.w"] + p[f"{name}.{j}.b"]
        if j + 1 < n:
            x = jax.nn.relu(x)
    return x


def forward(p, nodes, edges, globals_):
    """nodes [B,16,nd], edges [B,receiver 16,sender 16,ed], globals [B,gd]. Keys are pushed through the query kernel and
    messages are summed on the raw edge features, so nothing of size edges x 256 is ever made."""
    b = nodes.shape[0]
    x = nodes @ p["embed_node.w"] + p["embed_node.b"]
    g = globals_ @ p["embed_global.w"] + p["embed_global.b"]
    we, be = p["embed_edge.w"], p["embed_edge.b"]
    off_diagonal = jnp.where(jnp.eye(N, dtype=bool), -1e9, 0.0)
    for l in range(LAYERS):
        key = (x @ p[f"l{l}.key.w"]).reshape(b, N, HEADS, D)
        wq = p[f"l{l}.query.w"].reshape(2, D, HEADS, D)
        key_sender = jnp.einsum("brhd,ihd->brhi", key, wq[0])
        key_edge = jnp.einsum("brhd,ihd->brhi", key, wq[1])
        key_raw = key_edge @ we.T
        logits = jnp.einsum("brhi,bsi->brhs", key_sender, x) + jnp.einsum("brhe,brse->brhs", key_raw, edges)
        logits = (logits + (key_edge @ be)[..., None]) / D**0.5 + off_diagonal[:, None, :]
        w = jax.nn.softmax(logits, -1)
        sent = jnp.einsum("brhs,bsi->brhi", w, x)
        edge = jnp.einsum("brhs,brse->brhe", w, edges) @ we + be
        wm = p[f"l{l}.message.w"].reshape(2, D, HEADS, D)
        message = jnp.einsum("brhi,ihd->brhd", sent, wm[0]) + jnp.einsum("brhi,ihd->brhd", edge, wm[1])
        y = layer_norm(p, f"l{l}.ln_attn", x + message.reshape(b, N, HEADS * D) @ p[f"l{l}.node_proj.w"])
        wide = jnp.concatenate([y, jnp.broadcast_to(g[:, None], y.shape)], -1)
        x = layer_norm(p, f"l{l}.ln_mlp", y + mlp(p, f"l{l}.mlp_node", wide, 2))
        g = layer_norm(p, f"l{l}.ln_global", g + mlp(p, f"l{l}.mlp_global", jnp.concatenate([g, x.sum(1)], -1), 2))
    locs = x @ p["head.act_loc.w"] + p["head.act_loc.b"]
    scales = jax.nn.softplus(x @ p["head.act_scale.w"] + p["head.act_scale.b"]) + 1e-6
    grip = (jnp.concatenate([globals_ @ p["head.input_global.w"], g], -1) @ p["head.grip_key.w"]).reshape(b, GRIPPERS, D)
    held = globals_.reshape(b, GRIPPERS, -1)[:, :, -N:].transpose(0, 2, 1)
    logits = jnp.einsum("bgd,bnd->bgn", grip, jnp.concatenate([x, held], -1) @ p["head.block_key.w"]) / D**0.5
    probabilities = jax.lax.stop_gradient(jax.nn.softmax(logits, -1)).reshape(b, -1)
    v = jnp.concatenate([globals_ @ p["value.input_global.w"], g @ p["value.graph_global.w"], probabilities], -1)
    return locs, scales, logits, mlp(p, "value.mlp", v, 4)[:, 0]


def loss(p, nodes, edges, globals_):
    locs, scales, logits, value = forward(p, nodes, edges, globals_)
    return value.sum() + (logits**2).sum() + (locs**2).sum() + jnp.log(scales).sum()


def cpu_seconds():
    use = resource.getrusage(resource.RUSAGE_SELF)
    return use.ru_utime + use.ru_stime


def rate(f, batch, seconds=1.0):
    """Samples per CPU-second of f over at least `seconds` of wall time, after two warm-up calls."""
    for _ in range(2):
        jax.block_until_ready(f())
    start, wall, n = cpu_seconds(), time.perf_counter(), 0
    while time.perf_counter() - wall < seconds:
        jax.block_until_ready(f())
        n += batch
    return n / (cpu_seconds() - start)


def main():
    rng = np.random.default_rng(0)
    sizes = json.loads(subprocess.run([sys.argv[1], "--sizes"], check=True, capture_output=True, text=True).stdout)
    nd, ed, gd = sizes["node"], sizes["edge"], sizes["global"]
    p = init(rng, nd, ed, gd)
    fast, grad = jax.jit(forward), jax.jit(jax.grad(loss))
    cases = {}
    for name, f, batch in [("forward_1", fast, 1), ("forward_16", fast, 16), ("forward_64", fast, 64), ("update_512", grad, 512)]:
        inputs = [jnp.asarray(rng.normal(size=s), jnp.float32) for s in [(batch, N, nd), (batch, N, N, ed), (batch, gd)]]
        cases[name] = (lambda f=f, inputs=inputs: f(p, *inputs), batch)
    ours, jaxs = {}, {}
    for _ in range(3):
        out = json.loads(subprocess.run([sys.argv[1], "--json"], check=True, capture_output=True, text=True).stdout)
        for name, (f, batch) in cases.items():
            ours[name] = max(ours.get(name, 0.0), out[name])
            jaxs[name] = max(jaxs.get(name, 0.0), rate(f, batch))
    print(f"{'case':12} {'ours':>12} {'jax':>12}  ratio   (samples per CPU-second, best of 3)")
    for name in cases:
        print(f"{name:12} {ours[name]:12.0f} {jaxs[name]:12.0f}  {ours[name] / jaxs[name]:.2f}")


if __name__ == "__main__":
    main()

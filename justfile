# Shortcuts for `.ci/run`, which is what CI runs: a recipe here adds nothing to it. `just` is optional.

# List the recipes.
default:
    @just --list

# Everything that must pass before a change lands.
ci:
    .ci/run

# Formatting.
fmt:
    .ci/run fmt

# Fix the formatting.
fmt-fix:
    cargo fmt --all

# Spelling.
typos:
    .ci/run typos

# Licenses, sources and banned crates.
deny:
    .ci/run deny

# The same, and known vulnerabilities; needs the network.
advisories:
    cargo deny check

# Clippy without warnings.
lint:
    .ci/run lint

# Rustdoc without warnings.
doc:
    .ci/run doc

# All tests, or those that the arguments select: `just test -p policy gat`.
test *ARGS:
    {{ if ARGS == "" { ".ci/run test" } else { "cargo test --locked " + ARGS } }}

# The Python package and its judges; the network in PyTorch, and its export to ONNX.
python:
    .ci/run python

# Both fuzz targets, a minute each.
fuzz:
    .ci/run fuzz

# The Kubernetes manifests, without a cluster.
kubernetes:
    .ci/run kubernetes

# Rings under random faults, in containers, and on Slurm. Run as root; takes about 15 minutes.
launchers:
    .ci/run soak compose slurm

# Speed beside burn, jax, torch and MuJoCo, as in docs/performance.md: `just bench network --rounds 1`.
bench *ARGS:
    python3 tests/benches/peers.py --install {{ ARGS }}

# Instructions of the hot paths, compared with those in the repository; needs valgrind.
instructions *ARGS:
    cargo bench --locked -p tests --bench hot_paths --no-run
    python3 tests/benches/instructions.py "$(ls -t target/release/deps/hot_paths-* | grep -v '\.d$' | head -1)" {{ ARGS }}

# The program, for development.
build:
    cargo build --locked

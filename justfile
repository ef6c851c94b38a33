# Shortcuts for `.ci/run`, which CI runs directly. `just` is optional.

# List the recipes.
default:
    @just --list

# Run all checks that must pass before a change lands.
ci:
    .ci/run

# Run all steps, whatever changed, and those that are too slow for a change.
nightly:
    CI_CHANGED_SINCE= .ci/run
    .ci/run book demo examples release static gpu pictures

# Make a book of the pages, and check its links; needs the network for mdBook.
book:
    .ci/run book

# Lint the workflows.
workflows:
    .ci/run workflows

# Check the formatting.
fmt:
    .ci/run fmt

# Fix the formatting.
fmt-fix:
    cargo fmt --all

# Check the spelling.
typos:
    .ci/run typos

# Count what there is to read, beside its limits.
house:
    python3 lab/house.py

# Check licenses, sources, and banned crates.
deny:
    .ci/run deny

# Like `deny`, plus known vulnerabilities; needs the network.
advisories:
    cargo deny check

# Run Clippy and fail on warnings.
lint:
    .ci/run lint

# Check the page's scripts: their lint and their types.
page:
    .ci/run page

# Build the docs and fail on warnings.
doc:
    .ci/run doc

# Run all tests, or those selected by the arguments: `just test -p policy gat`.
test *ARGS:
    {{ if ARGS == "" { ".ci/run test" } else { "cargo test --locked " + ARGS } }}

# Test the Python package with third-party checkers, the PyTorch network, and its ONNX export.
python:
    .ci/run python

# Run the examples that need more packages.
examples:
    .ci/run examples

# Run both fuzz targets for a minute each.
fuzz:
    .ci/run fuzz

# Check the Kubernetes manifests, without a cluster.
kubernetes:
    .ci/run kubernetes

# Test rings under random faults, in containers, and on Slurm. Run as root; takes about 15 minutes.
launchers:
    .ci/run soak compose slurm

# Compare speed with burn, jax, torch, and MuJoCo, as in docs/performance.md: `just bench network --rounds 1`.
bench *ARGS:
    python3 lab/benches/peers.py --install {{ ARGS }}

# Compare the hot paths' instruction counts with those in the repository; needs valgrind.
instructions *ARGS:
    cargo bench --locked -p lab --bench hot_paths --no-run
    python3 lab/benches/instructions.py "$(ls -t target/release/deps/hot_paths-* | grep -v '\.d$' | head -1)" {{ ARGS }}

# Build the program for development.
build:
    cargo build --locked

//! The network and the action distribution against external reference values: the files in `tests/golden`, made with
//! the paper's listing in JAX. The CPU kernels also against burn, in other shapes.

#![allow(clippy::unwrap_used)]

mod common;
mod cpu;
mod distribution;
mod network;
mod units;

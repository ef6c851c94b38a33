//! The network and the action distribution against external reference values: the files in `tests/golden`, made with
//! the paper's listing in JAX, and an unfolded form of the graph encoder.

#![allow(clippy::unwrap_used)]

mod common;
mod cpu;
mod distribution;
mod naive;
mod network;
mod units;

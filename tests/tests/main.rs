//! Behaviour across crates, and the rules that hold the workspace together.
#![allow(clippy::unwrap_used)]

mod architecture;
mod configs;
mod repository;
mod tidy;

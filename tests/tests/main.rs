//! Behavior across crates, and the rules that hold the workspace together.
#![allow(clippy::unwrap_used)]

mod architecture;
mod circles;
mod compatibility;
mod configs;
mod context;
mod joins;
mod learning;
mod pretrained;
mod repository;
mod settings;
mod tidy;

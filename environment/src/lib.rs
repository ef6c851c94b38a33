//! The physical world of magnet blocks: initial states, steps, rewards and success.
//!
//! Reading order: [`mod@env`] (what a world offers) → [`world`] → `reset`, `grippers`, `magnets`, `connections` (what happens
//! inside a step) → `engine` (the rigid-body engine) → [`reward`], [`success`] (pure functions) → [`config`] → [`contract`]
//! (checks for any environment).

#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod config;
pub mod contract;
pub mod env;
pub mod expert;
pub mod reward;
pub mod success;
pub mod world;

mod connections;
mod convert;
mod engine;
mod grippers;
mod magnets;
#[cfg(test)]
mod physics_tests;
mod reset;

pub use config::EnvironmentConfig;
pub use env::{Env, ResetError, StepResult};
pub use expert::{Activity, Decision, Expert};
pub use reset::sample_assignment;
pub use success::StableSuccess;
pub use world::World;

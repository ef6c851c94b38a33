//! The physical world of magnet blocks: initial states, steps, rewards, and success.
//!
//! Reading order: [`mod@env`] (the interface) → [`world`] → `reset`, [`arrangement`], `randomization`, `grippers`, `magnets`,
//! `connections` (what happens in a step) → `engine` (the rigid-body engine) → [`reward`], [`success`] (pure functions)
//! → [`vec_env`] (many worlds at a time) → [`expert`] → [`config`].

#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod arrangement;
pub mod config;
pub mod env;
pub mod expert;
pub mod reward;
pub mod success;
pub mod vec_env;
pub mod world;

mod connections;
mod convert;
mod engine;
mod grippers;
mod magnets;
mod randomization;
mod reset;
#[cfg(test)]
mod tests;

pub use arrangement::{Arrangement, ArrangementError};
pub use config::EnvironmentConfig;
pub use env::{Env, ResetError, StartError, StepResult};
pub use expert::{Expert, ExpertAgent};
pub use reset::sample_assignment;
pub use success::StableSuccess;
pub use vec_env::VecEnv;
pub use world::World;

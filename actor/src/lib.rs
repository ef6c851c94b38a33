//! From tasks to trajectories: steps many worlds with the newest weights and sends segments to the learner.
//!
//! Reading order: [`config`] → [`task`] (what to build next) → `segment` (episodes cut into segments) → [`rollout`]
//! (worlds and policy together, synchronously) → [`lockstep`] or `backlog` and `streams` → [`run()`] (threads and the
//! bus).

#![cfg_attr(test, allow(clippy::unwrap_used))]

mod backlog;
pub mod config;
pub mod lockstep;
pub mod rollout;
mod run;
mod segment;
mod setup;
mod streams;
pub mod task;
#[cfg(test)]
mod tests;

pub use config::{ActorConfig, FullBacklog};
pub use environment::EnvironmentConfig;
pub use lockstep::Lockstep;
pub use policy::PolicyConfig;
pub use rollout::{Rollout, RolloutCounters, RolloutError};
pub use run::{METRICS_PERIOD, N_OUTSTANDING, Summary, run};
pub use setup::ActorSetup;
pub use task::{FilterError, TaskConfig, TaskFilter, TaskSampler};

//! Tests of the whole learner with synthetic trajectories.

mod checkpoints;
#[cfg(feature = "gpu")]
mod device;
mod goals;
pub(crate) mod learning;
mod mixture;
mod saving;
mod service;

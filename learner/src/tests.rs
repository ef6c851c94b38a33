//! Tests of the whole learner with synthetic trajectories.

mod checkpoints;
mod device;
pub(crate) mod fixtures;
pub(crate) mod learning;
mod mixture;
mod saving;
mod service;

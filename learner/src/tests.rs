//! Tests of the whole learner with synthetic trajectories.

mod checkpoints;
mod goals;
pub(crate) mod learning;
mod saving;
mod service;

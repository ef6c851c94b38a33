//! Tests of the whole learner with synthetic trajectories.

mod checkpoints;
mod goals;
mod learning;
mod service;

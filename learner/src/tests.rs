//! The learner as a whole, on synthetic trajectories.

mod checkpoints;
mod goals;
mod learning;
mod service;

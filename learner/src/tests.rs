//! The learner as a whole, on synthetic trajectories.

mod checkpoints;
mod learning;
mod service;

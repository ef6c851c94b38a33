//! The bus between real sessions: each test has its own router on a unix socket in a temporary folder.

#![allow(clippy::unwrap_used)]

mod alive;
mod cluster;
mod learner_away;
mod metrics;
#[path = "../../../proto/src/codec/tests/samples.rs"]
mod samples;
mod strangers;
mod trajectories;
mod units;
mod viewer;
mod weights;

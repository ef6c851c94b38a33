//! The bus between real sessions: each test has its own router on a Unix socket in a temporary folder.

#![allow(clippy::unwrap_used)]

mod alive;
mod cluster;
mod floods;
mod invalid_messages;
mod learner_away;
mod metrics;
#[path = "../../../proto/src/codec/tests/samples.rs"]
mod samples;
mod trajectories;
mod weights;

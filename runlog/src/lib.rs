//! The files of a run: their paths, writers, and readers.
//!
//! Reading order: [`paths`] → [`writer`] (`metrics.jsonl`, and [`tensorboard`] event files) → [`history`] (`eval.db`) →
//! [`series`] and [`overview`] (summaries of a history by blueprint, by group, and as JSON) → [`videos`] (names of
//! videos and recordings). The learner manages its own checkpoints.

#![cfg_attr(test, allow(clippy::unwrap_used))]

#[cfg(test)]
extern crate self as runlog; // Tests of other crates use the samples.

pub mod history;
pub mod overview;
pub mod paths;
pub mod series;
pub mod tensorboard;
pub mod videos;
pub mod writer;

pub use history::{Evaluation, History, HistoryError};
pub use paths::RunPaths;
pub use writer::{Lines, MetricsWriter, WriteError, lines};

//! What a run leaves in its folder: where each file lies, how it is written, and how it is read again.
//!
//! Reading order: [`paths`] → [`writer`] (`metrics.jsonl`, and [`tensorboard`] behind it) → [`history`] (`eval.db`) → [`series`] and
//! [`overview`] (numbers of a history by blueprint, by group, and in short) → [`clips`] (names of videos and recordings).
//! Checkpoints are the learner's own.

#![cfg_attr(test, allow(clippy::unwrap_used))]

#[cfg(test)]
extern crate self as runlog; // The samples of the tests serve other crates too.

pub mod clips;
pub mod history;
pub mod overview;
pub mod paths;
pub mod series;
pub mod tensorboard;
pub mod writer;

pub use history::{History, HistoryError, Pass};
pub use paths::RunPaths;
pub use writer::{Lines, MetricsWriter, WriteError};

//! Evaluates weights: runs episodes of a frozen policy and reports success per blueprint and group, with its
//! uncertainty.
//!
//! Reading order: [`config`] → [`report`] (what is counted) → `sequences` (batched worlds) → `pool` (threads) →
//! [`episodes`] and `reset_free` (what is run) → `endings` (how episodes end) → [`table`] (what is printed) →
//! [`best`] (which weights are the best of a run) → [`run()`] (the service on the bus). `videos` records videos in
//! every evaluation, [`perform`] plays one episode for display, and [`record()`] records many.

#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod best;
pub mod config;
mod endings;
pub mod episodes;
mod nice;
mod performance;
mod pool;
pub mod record;
mod recording;
mod records;
pub mod report;
mod reset_free;
mod run;
mod schedule;
mod sequences;
pub mod setup;
mod spec;
pub mod table;
pub mod trials;
mod videos;

pub use best::{Scored, Verdict};
pub use config::{
    EpisodeConfig, EvaluatorConfig, EvaluatorConfigError, Every, ResetFreeConfig, Selection, Starts, VideosConfig,
};
pub use endings::Endings;
pub use environment::EnvironmentConfig;
pub use episodes::{Follower, evaluate};
pub use performance::{Performance, perform};
pub use policy::{Policy, PolicyConfig, PolicyError};
pub use pool::EvaluationProgress;
pub use record::record;
pub use run::{Listeners, Stop, run};
pub use setup::{EvalError, EvalSetup, EvaluatorSetup, N_WORLDS, Performer};
pub use table::render;

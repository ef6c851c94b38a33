//! The bus: zenoh sessions that carry [`proto`]'s messages between actors, learner, evaluator, and viewers.
//!
//! Reading order: `config`, [`security`], and `gate` (authentication) → `session` and `followed` → `sender` and
//! `ingest` (trajectories) → `weights` → `metrics` and `viewer` → `latest`, `turns`, and `refusals` (floods) → `alive`
//! and `pulse`.
//!
//! Trajectories are acknowledged queries to the learner, weights are pulled after a notice, metrics are JSON, and
//! liveliness tokens show which processes are alive. The services use only the types of this crate, never zenoh's.
//!
//! Nothing here blocks in a zenoh callback: a slow callback would stall every peer of the session. Callbacks hand work
//! to tokio tasks through bounded channels; overflow is dropped and counted.

#![cfg_attr(test, allow(clippy::unwrap_used))]

mod access;
mod alive;
mod config;
mod error;
mod followed;
mod gate;
mod ingest;
mod latest;
mod matching;
mod metrics;
mod pulse;
mod refusals;
pub mod security;
mod sender;
mod session;
mod turns;
mod viewer;
mod weights;

pub use alive::{AliveToken, AliveWatch, NAME_PATIENCE, runs};
pub use config::{BusConfig, BusMode};
pub use error::{BusError, SendError};
pub use followed::Followed;
pub use gate::JoinCounts;
pub use ingest::TrajectoryServer;
pub use metrics::{HistoryAnswer, MetricsPublisher, MetricsSample, MetricsSubscriber};
pub use pulse::{Pulse, Waiting};
pub use security::{KeysError, SecurityConfig};
pub use sender::TrajectorySender;
pub use session::{Bus, unix_ms};
pub use viewer::TrajectoryViewer;
pub use weights::{WeightsPublisher, WeightsSubscriber};

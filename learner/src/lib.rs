//! The learner: PPO from trajectories to weights, with checkpoints and curriculum.
//!
//! [`train`] is the algorithm on one page. What it calls: [`source`] and [`mailbox`] (where trajectories come from),
//! [`batch`], `ppo`, [`loss`], [`advantages`], [`gae`], [`adam`]; [`curriculum`] (what is played next); [`learner`]
//! (the state, and how it is resumed) and [`checkpoint`]. [`mod@run`] is the service on the bus.

#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod adam;
pub mod admission;
pub mod advantages;
pub mod batch;
pub mod checkpoint;
pub mod config;
pub mod curriculum;
mod draws;
pub mod episodes;
pub mod gae;
pub mod learner;
pub mod loss;
pub mod mailbox;
pub mod metrics;
pub mod model;
pub mod normalization;
mod ppo;
pub mod run;
pub mod source;
pub mod state;
#[cfg(test)]
mod tests;
pub mod train;
mod trial;

pub use admission::{ActingLimits, Admission};
pub use checkpoint::{Checkpoint, CheckpointError};
pub use config::LearnerConfig;
pub use learner::{Learner, LearnerError, LearnerSetup};
pub use mailbox::{Mailbox, MailboxCounts};
pub use metrics::UpdateResult;
pub use model::read_model;
pub use policy::Model;
pub use policy::device::{DeviceError, DeviceKind};
pub use run::{RunOptions, check, run};
pub use source::Source;
pub use train::{Diverged, SAVE_RETRY, Summary};

//! The interface between processes: validated plain types, their wire format, and key expressions. It does no I/O.
//!
//! Reading order: the types [`scene`] → [`step`] → [`disturbance`] → [`agent`] → [`trajectory`] → [`weights`], and the reports
//! [`metrics`] → [`codec`] → [`keys`].

#![cfg_attr(test, allow(clippy::unwrap_used))]

#[cfg(test)]
extern crate self as proto; // The unit tests share the samples of the integration tests.

pub mod agent;
mod canonical;
pub mod codec;
pub mod disturbance;
pub mod keys;
pub mod metrics;
mod rng;
pub mod scene;
pub mod setting;
pub mod step;
pub mod trajectory;
mod valid;
pub mod weights;
pub mod wilson;
mod wire;

pub use agent::{Agent, Decision, Observation};
pub use canonical::{CanonicalSettings, NotCanonical, SettingsDifference, config_hash};
pub use codec::{DecodeError, Refusal};
pub use disturbance::{Disturbance, InvalidDisturbance};
pub use keys::Role;
pub use rng::SavedRng;
pub use scene::{Gripper, Joint, N_GRIPPERS, Pose, Scene};
pub use setting::InvalidSetting;
pub use step::{Action, ActionMode, InvalidActionMode, Move, RewardTerms, Status};
pub use trajectory::{ActorId, BehaviorPolicy, EpisodeStats, InvalidActorId, Start, Task, Trajectory, Transition};
pub use valid::Valid;
pub use weights::{Normalization, Weights, WeightsVersion};

//! Errors of the bus.

use super::{BusConfigError, KeysError};
use proto::codec::{DecodeError, Refusal};

/// An error of a session.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The configuration breaks a rule.
    #[error(transparent)]
    Config(#[from] BusConfigError),
    /// The keys cannot be used.
    #[error(transparent)]
    Keys(#[from] KeysError),
    /// Zenoh returned an error.
    #[error("{action}: {source}")]
    Zenoh {
        /// The failed operation.
        action: String,
        /// Zenoh's error.
        source: zenoh::Error,
    },
    /// A name is not valid in a key.
    #[error("name {0:?} is not 1 to 64 characters of a-z, 0-9 and -")]
    Name(String),
    /// Another live process has this name and role.
    #[error("another live {role} of this run is called {name:?}; {advice}")]
    NameTaken {
        /// The role.
        role: &'static str,
        /// The name.
        name: String,
        /// Advice for the user.
        advice: &'static str,
    },
    /// Metrics cannot be serialized as JSON.
    #[error("metrics {key} cannot be written as JSON: {source}")]
    Json {
        /// Their key.
        key: String,
        /// The serializer's error.
        source: serde_json::Error,
    },
    /// Weights exceed the size that receivers accept.
    #[error("weights of {bytes} bytes are larger than the limit of {limit} bytes")]
    TooLarge {
        /// Encoded size.
        bytes: usize,
        /// Largest size allowed.
        limit: usize,
    },
}

impl BusError {
    /// For `map_err`: names the operation that failed in zenoh.
    pub(super) fn during(action: impl Into<String>) -> impl FnOnce(zenoh::Error) -> Self {
        let action = action.into();
        move |source| Self::Zenoh { action, source }
    }
}

/// Reasons why the learner does not have, or may not have, a trajectory.
#[derive(Debug, thiserror::Error)]
pub enum SendError {
    /// The learner refused it.
    #[error("the learner refused the trajectory: {0}")]
    Refused(Refusal),
    /// No learner is present; wait for one.
    #[error("no learner is there")]
    NoLearner,
    /// A learner gave no answer in time and may or may not have the trajectory. Sending the same one again is safe.
    #[error("the learner gave no answer")]
    NoReply,
    /// It exceeds the size that the learner accepts.
    #[error("a trajectory of {bytes} bytes is larger than the limit of {limit} bytes")]
    TooLarge {
        /// Encoded size.
        bytes: usize,
        /// Largest size allowed.
        limit: usize,
    },
    /// The answer is invalid.
    #[error("the learner's answer cannot be read: {0}")]
    BadReply(#[from] DecodeError),
    /// The session is closed or broken.
    #[error("sending a trajectory: {0}")]
    Zenoh(zenoh::Error),
}

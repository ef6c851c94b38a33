//! Errors of the bus.

use super::{BusConfigError, KeysError};
use proto::codec::{DecodeError, Refusal};

/// The error of an operation on the session.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The configuration breaks a rule.
    #[error(transparent)]
    Config(#[from] BusConfigError),
    /// The keys cannot be used.
    #[error(transparent)]
    Keys(#[from] KeysError),
    /// Zenoh refused.
    #[error("{action}: {source}")]
    Zenoh {
        /// What was being done.
        action: String,
        /// What zenoh says.
        source: zenoh::Error,
    },
    /// A name that cannot be part of a key.
    #[error("name {0:?} is not 1 to 64 characters of a-z, 0-9 and -")]
    Name(String),
    /// Somebody of this name and role is there.
    #[error("another live {role} of this run is called {name:?}; {advice}")]
    NameTaken {
        /// What it is.
        role: &'static str,
        /// The name of both.
        name: String,
        /// What to do.
        advice: &'static str,
    },
    /// Metrics that cannot be JSON.
    #[error("metrics {key} cannot be written as JSON: {source}")]
    Json {
        /// Their key.
        key: String,
        /// What the serializer says.
        source: serde_json::Error,
    },
    /// Weights larger than what receivers accept.
    #[error("weights of {bytes} bytes are larger than the limit of {limit} bytes")]
    TooLarge {
        /// Encoded size.
        bytes: usize,
        /// Largest size allowed.
        limit: usize,
    },
}

impl BusError {
    /// For `map_err`: says what was being done when zenoh refused.
    pub(super) fn during(action: impl Into<String>) -> impl FnOnce(zenoh::Error) -> Self {
        let action = action.into();
        move |source| Self::Zenoh { action, source }
    }
}

/// Why a trajectory is not with the learner.
#[derive(Debug, thiserror::Error)]
pub enum SendError {
    /// The learner did not want it.
    #[error("the learner refused the trajectory: {0}")]
    Refused(Refusal),
    /// No learner is there; wait for one.
    #[error("no learner is there")]
    NoLearner,
    /// A learner is or was there but gave no answer in time: it may have the trajectory or not. Sending the same one
    /// again is safe.
    #[error("the learner gave no answer")]
    NoReply,
    /// Larger than what the learner accepts.
    #[error("a trajectory of {bytes} bytes is larger than the limit of {limit} bytes")]
    TooLarge {
        /// Encoded size.
        bytes: usize,
        /// Largest size allowed.
        limit: usize,
    },
    /// The answer makes no sense.
    #[error("the learner's answer cannot be read: {0}")]
    BadReply(#[from] DecodeError),
    /// The session is closed or broken.
    #[error("sending a trajectory: {0}")]
    Zenoh(zenoh::Error),
}

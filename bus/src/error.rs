//! Errors of the bus.

use super::KeysError;
use proto::Role;
use proto::codec::{DecodeError, MAX_TRAJECTORY_BYTES, MAX_WEIGHTS_BYTES, Refusal};

/// An error of a session.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The keys cannot be used.
    #[error(transparent)]
    Keys(#[from] KeysError),
    /// The clock is before 1970, and zenoh would panic in some thread.
    #[error("the clock of this machine is before 1970, and messages carry its time: set it")]
    Clock,
    /// This operation failed in zenoh or the system. The error is not a source, because the source locations in zenoh's
    /// would then be printed after the reason.
    #[error("{0}: {reason}", reason = reason(.1))]
    Failed(String, zenoh::Error),
    /// A name is not valid in a key.
    #[error("name {0:?} is not 1 to 64 characters of a-z, 0-9 and -")]
    Name(String),
    /// Another live process has this name and role.
    #[error("another live {role} of this run is called {1:?}; {advice}", role = .0.as_str(), advice = advice(*.0))]
    NameTaken(Role, String),
    /// The router did not say in time which processes are alive.
    #[error("the router does not say which processes are alive; see that it runs and is not overloaded")]
    NoAnswer,
    /// Weights exceed the size that receivers accept.
    #[error("weights of {0} bytes are larger than the limit of {MAX_WEIGHTS_BYTES} bytes")]
    TooLarge(usize),
}

impl BusError {
    /// For `map_err`: names the operation that failed.
    pub(super) fn during(action: impl Into<String>) -> impl FnOnce(zenoh::Error) -> Self {
        let action = action.into();
        move |error| Self::Failed(action, error)
    }
}

fn advice(role: Role) -> &'static str {
    match role {
        Role::Learner => "there can be one only: end it, or choose another --run",
        _ => "choose another --id",
    }
}

/// Returns zenoh's message without the source locations that it appends to every error: ` at /…/unicast.rs:338.`
fn reason(error: &zenoh::Error) -> String {
    without_places(&error.to_string())
}

fn without_places(text: &str) -> String {
    /// Precedes a path; the path itself begins at the slash.
    const AT: &str = " at /";
    let mut parts = text.split(AT);
    let mut plain = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let end = part.find(|c: char| c.is_whitespace() || c == ']').unwrap_or(part.len());
        if part[..end].contains(".rs:") {
            plain += &part[end..];
        } else {
            plain.extend([AT, part]);
        }
    }
    plain
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
    /// The learner did not answer in time and may or may not have the trajectory. Sending the same one again is safe.
    #[error("the learner gave no answer")]
    NoReply,
    /// The trajectory exceeds the size that the learner accepts.
    #[error("a trajectory of {0} bytes is larger than the limit of {MAX_TRAJECTORY_BYTES} bytes")]
    TooLarge(usize),
    /// The answer is invalid.
    #[error("the learner's answer cannot be read: {0}")]
    BadReply(#[from] DecodeError),
    /// The session is closed or broken.
    #[error("sending a trajectory: {}", reason(.0))]
    Zenoh(zenoh::Error),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_name_no_places_in_code() {
        let text = "no listener on tcp/127.0.0.1:1: [127.0.0.1:1: Address already in use (os error 98) at \
                    /src/commons-1.10.2/src/tcp.rs:61.] at /src/tcp-1.10.2/src/unicast.rs:338.";
        let plain = "no listener on tcp/127.0.0.1:1: [127.0.0.1:1: Address already in use (os error 98)]";
        assert_eq!(without_places(text), plain);
        for text in ["no lock at /run/x.sock for us", "nothing to cut"] {
            assert_eq!(without_places(text), text);
        }
        let error = BusError::during("listening on tcp/127.0.0.1:1")(text.into());
        assert_eq!(error.to_string(), format!("listening on tcp/127.0.0.1:1: {plain}"));
        assert!(std::error::Error::source(&error).is_none());
    }
}

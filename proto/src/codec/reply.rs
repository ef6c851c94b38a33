//! The learner's answers to a trajectory.

use prost::Message;

use super::check::invalid;
use super::{DecodeError, MAX_SMALL_BYTES, PROTOCOL_VERSION, check_version, parse};
use crate::{WeightsVersion, wire};

/// Longest explanation that travels with a refusal, in characters.
const MAX_DETAIL_CHARS: usize = 500;

/// The learner took the trajectory, now or at an earlier attempt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ack {
    /// The learner's current weights.
    pub weights_version: WeightsVersion,
}

/// Why the learner did not take a trajectory.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// The weights that acted are too old.
    #[error("the weights that acted are too old")]
    Stale,
    /// The mailbox is full.
    #[error("the mailbox is full")]
    Full,
    /// The message breaks the rule that the text names; sending it again is pointless.
    #[error("invalid: {0}")]
    Invalid(String),
    /// Another live process has the actor's name and was first.
    #[error("another live actor has this name")]
    NameTaken,
}

/// A refusal as it travels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refused {
    /// Why.
    pub refusal: Refusal,
    /// The learner's current weights.
    pub weights_version: WeightsVersion,
}

/// The bytes of an acknowledgement.
pub fn encode_ack(ack: Ack) -> Vec<u8> {
    wire::Ack { protocol_version: PROTOCOL_VERSION, weights_version: ack.weights_version.0 }.encode_to_vec()
}

/// Reads an acknowledgement.
///
/// # Errors
/// If the bytes are not one of this protocol version.
pub fn decode_ack(bytes: &[u8]) -> Result<Ack, DecodeError> {
    let ack: wire::Ack = parse("Ack", bytes, MAX_SMALL_BYTES)?;
    check_version(ack.protocol_version)?;
    Ok(Ack { weights_version: WeightsVersion(ack.weights_version) })
}

/// The bytes of a refusal; an explanation over 500 characters is cut.
pub fn encode_refused(refused: &Refused) -> Vec<u8> {
    let (reason, detail) = match &refused.refusal {
        Refusal::Stale => (wire::RefusalReason::Stale, String::new()),
        Refusal::Full => (wire::RefusalReason::Full, String::new()),
        Refusal::NameTaken => (wire::RefusalReason::NameTaken, String::new()),
        Refusal::Invalid(detail) => (wire::RefusalReason::Invalid, detail.chars().take(MAX_DETAIL_CHARS).collect()),
    };
    wire::Refusal {
        protocol_version: PROTOCOL_VERSION,
        weights_version: refused.weights_version.0,
        reason: reason.into(),
        detail,
    }
    .encode_to_vec()
}

/// Reads a refusal.
///
/// # Errors
/// If the bytes are not one of this protocol version, or the reason is unknown.
pub fn decode_refused(bytes: &[u8]) -> Result<Refused, DecodeError> {
    let refusal: wire::Refusal = parse("Refusal", bytes, MAX_SMALL_BYTES)?;
    check_version(refusal.protocol_version)?;
    let reason = match wire::RefusalReason::try_from(refusal.reason) {
        Ok(wire::RefusalReason::Stale) => Refusal::Stale,
        Ok(wire::RefusalReason::Full) => Refusal::Full,
        Ok(wire::RefusalReason::Invalid) => Refusal::Invalid(refusal.detail),
        Ok(wire::RefusalReason::NameTaken) => Refusal::NameTaken,
        Ok(wire::RefusalReason::Unspecified) | Err(_) => {
            return Err(invalid("refusal.reason", refusal.reason, "a known reason"));
        }
    };
    Ok(Refused { refusal: reason, weights_version: WeightsVersion(refusal.weights_version) })
}

//! The learner's answers to a trajectory.

use prost::Message;

use super::check::invalid;
use super::{DecodeError, MAX_SMALL_BYTES, PROTOCOL_VERSION, check_version, parse};
use crate::{WeightsVersion, wire};

/// Maximum length of a refusal's explanation, in characters.
const MAX_DETAIL_CHARS: usize = 500;

/// Confirmation that the learner accepted the trajectory, now or on an earlier attempt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ack {
    /// Version of the learner's current weights.
    pub weights_version: WeightsVersion,
}

/// The learner's reason for refusing a trajectory.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// The weights that acted are too old.
    #[error("the weights that acted are too old")]
    Stale,
    /// The mailbox is full.
    #[error("the mailbox is full")]
    Full,
    /// The message breaks the rule given in the text; sending it again is pointless.
    #[error("invalid: {0}")]
    Invalid(String),
    /// Another live process already owns the actor's name.
    #[error("another live actor has this name")]
    NameTaken,
}

/// A refusal with the learner's version.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refused {
    /// The reason.
    pub refusal: Refusal,
    /// Version of the learner's current weights.
    pub weights_version: WeightsVersion,
}

/// Encodes an acknowledgement.
pub fn encode_ack(ack: Ack) -> Vec<u8> {
    wire::Ack { protocol_version: PROTOCOL_VERSION, weights_version: ack.weights_version.0 }.encode_to_vec()
}

/// Decodes an acknowledgement.
///
/// # Errors
/// If the bytes are not an acknowledgement of this protocol version.
pub fn decode_ack(bytes: &[u8]) -> Result<Ack, DecodeError> {
    let ack: wire::Ack = parse("Ack", bytes, MAX_SMALL_BYTES)?;
    check_version(ack.protocol_version)?;
    Ok(Ack { weights_version: WeightsVersion(ack.weights_version) })
}

/// Encodes a refusal; an explanation over 500 characters is truncated.
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

/// Decodes a refusal.
///
/// # Errors
/// If the bytes are not a refusal of this protocol version, or the reason is unknown.
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

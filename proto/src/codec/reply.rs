//! The learner's answers to a trajectory.

use prost::Message;

use super::check::invalid;
use super::{DecodeError, MAX_SMALL_BYTES, PROTOCOL_VERSION, check_version, parse};
use crate::{WeightsVersion, wire};

/// Maximum length of a refusal's explanation, in characters.
const MAX_DETAIL_CHARS: usize = 500;

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

/// Encodes the confirmation that a learner with the weights `newest` has a trajectory.
pub fn encode_ack(newest: WeightsVersion) -> Vec<u8> {
    wire::Ack { protocol_version: PROTOCOL_VERSION, weights_version: newest.0 }.encode_to_vec()
}

/// Decodes a confirmation, and returns the version of the learner's weights.
///
/// # Errors
/// If the bytes are not a confirmation of this protocol version.
pub fn decode_ack(bytes: &[u8]) -> Result<WeightsVersion, DecodeError> {
    let ack: wire::Ack = parse("Ack", bytes, MAX_SMALL_BYTES)?;
    check_version(ack.protocol_version)?;
    Ok(WeightsVersion(ack.weights_version))
}

/// Encodes a refusal by a learner with the weights `newest`; an explanation over 500 characters is truncated.
pub fn encode_refusal(refusal: &Refusal, newest: WeightsVersion) -> Vec<u8> {
    let (reason, detail) = match refusal {
        Refusal::Stale => (wire::RefusalReason::Stale, String::new()),
        Refusal::Full => (wire::RefusalReason::Full, String::new()),
        Refusal::NameTaken => (wire::RefusalReason::NameTaken, String::new()),
        Refusal::Invalid(detail) => (wire::RefusalReason::Invalid, detail.chars().take(MAX_DETAIL_CHARS).collect()),
    };
    wire::Refusal { protocol_version: PROTOCOL_VERSION, weights_version: newest.0, reason: reason.into(), detail }
        .encode_to_vec()
}

/// Decodes a refusal.
///
/// # Errors
/// If the bytes are not a refusal of this protocol version, or the reason is unknown.
pub fn decode_refusal(bytes: &[u8]) -> Result<Refusal, DecodeError> {
    let refusal: wire::Refusal = parse("Refusal", bytes, MAX_SMALL_BYTES)?;
    check_version(refusal.protocol_version)?;
    match wire::RefusalReason::try_from(refusal.reason) {
        Ok(wire::RefusalReason::Stale) => Ok(Refusal::Stale),
        Ok(wire::RefusalReason::Full) => Ok(Refusal::Full),
        Ok(wire::RefusalReason::Invalid) => Ok(Refusal::Invalid(refusal.detail)),
        Ok(wire::RefusalReason::NameTaken) => Ok(Refusal::NameTaken),
        Ok(wire::RefusalReason::Unspecified) | Err(_) => {
            Err(invalid("refusal.reason", refusal.reason, "a known reason"))
        }
    }
}

//! Conversion between plain types and protobuf bytes. Decoding validates every message, so a decoded value obeys every
//! rule that its type documents.

mod check;
mod error;
mod reply;
mod scene;
#[cfg(test)]
mod tests;
mod trajectory;
mod weights;

use prost::Message;
use prost::bytes::Buf;
use prost::encoding::{DecodeContext, decode_key, skip_field};

pub use error::DecodeError;
pub use prost::bytes::Bytes;
pub use reply::{Refusal, decode_ack, decode_refusal, encode_ack, encode_refusal};
pub use trajectory::{
    MAX_RECORDING_BYTES, MAX_SEGMENT_STEPS, MAX_TRAJECTORY_BYTES, TRAJECTORY_HEADER_BYTES, decode_recording,
    decode_trajectory, encode_recording, encode_trajectory, trajectory_actor,
};
pub use weights::{
    MAX_PARAMETERS, MAX_WEIGHTS_BYTES, PublishedWeights, WeightsNotice, decode_notice, decode_weights, encode_notice,
    encode_weights,
};

/// The protocol version that this process writes, and the only one that it reads from the bus. Recordings of version 1
/// are read as well.
pub const PROTOCOL_VERSION: u32 = 2;

/// Size limit of messages that hold a few numbers.
const MAX_SMALL_BYTES: usize = 4096;

/// Parses `bytes` if they are at most `limit` long.
fn parse<M: Message + Default>(message: &'static str, bytes: impl Buf, limit: usize) -> Result<M, DecodeError> {
    check_size(message, bytes.remaining(), limit)?;
    M::decode(bytes).map_err(|error| DecodeError::Malformed(message, error))
}

fn check_size(message: &'static str, bytes: usize, limit: usize) -> Result<(), DecodeError> {
    let too_large = || format!("{message} of {bytes} bytes is larger than the limit of {limit} bytes");
    if bytes > limit { Err(DecodeError::Invalid(too_large())) } else { Ok(()) }
}

/// Returns an error that says what is `expected` if a message's repeated field has more than `limit` elements.
///
/// An empty element is two bytes long and becomes a value of hundreds of bytes, so this check comes before parsing.
fn check_count(
    message: &'static str,
    (field, tag): (&'static str, u32),
    mut bytes: &[u8],
    (limit, expected): (usize, &'static str),
) -> Result<(), DecodeError> {
    let malformed = |error| DecodeError::Malformed(message, error);
    let mut n_elements = 0;
    while !bytes.is_empty() {
        let (key, wire_type) = decode_key(&mut bytes).map_err(malformed)?;
        n_elements += usize::from(key == tag);
        if n_elements > limit {
            return Err(check::invalid(field, format!("more than {limit}"), expected));
        }
        skip_field(wire_type, key, &mut bytes, DecodeContext::default()).map_err(malformed)?;
    }
    Ok(())
}

fn check_version(found: u32) -> Result<(), DecodeError> {
    if found == PROTOCOL_VERSION {
        return Ok(());
    }
    Err(DecodeError::Invalid(format!(
        "it has protocol version {found}, and this process speaks version {PROTOCOL_VERSION}: run one version of \
         Lodestone in all processes"
    )))
}

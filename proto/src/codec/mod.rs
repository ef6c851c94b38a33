//! Conversion between plain types and protobuf bytes. Decoding validates every message, so a decoded value obeys every
//! rule that its type documents.

mod check;
mod error;
mod reply;
mod scene;
#[cfg(test)]
mod tests;
mod trajectory;
mod unit;
mod weights;

use prost::Message;
use prost::bytes::Buf;

pub use error::DecodeError;
pub use prost::bytes::Bytes;
pub use reply::{Ack, Refusal, Refused, decode_ack, decode_refused, encode_ack, encode_refused};
pub use trajectory::{MAX_SEGMENT_STEPS, MAX_TRAJECTORY_BYTES, decode_trajectory, encode_trajectory};
pub use unit::{MAX_UNIT_BYTES, decode_answer, decode_unit, encode_answer, encode_unit};
pub use weights::{
    MAX_PARAMETERS, MAX_WEIGHTS_BYTES, PublishedWeights, WeightsNotice, decode_notice, decode_weights, encode_notice,
    encode_weights,
};

/// The only protocol version that this process writes and reads.
pub const PROTOCOL_VERSION: u32 = 1;

/// Size limit of messages that hold a few numbers.
const MAX_SMALL_BYTES: usize = 4096;

/// Parses `bytes` if they are at most `limit` long.
fn parse<M: Message + Default>(message: &'static str, bytes: impl Buf, limit: usize) -> Result<M, DecodeError> {
    if bytes.remaining() > limit {
        return Err(DecodeError::TooLarge { message, bytes: bytes.remaining(), limit });
    }
    M::decode(bytes).map_err(|source| DecodeError::Malformed { message, source })
}

fn check_version(found: u32) -> Result<(), DecodeError> {
    if found == PROTOCOL_VERSION { Ok(()) } else { Err(DecodeError::Version { found, expected: PROTOCOL_VERSION }) }
}

//! The beginning of a trajectory, which shows most garbage before anything is decoded.

use prost::encoding::{WireType, decode_key, decode_varint};

use super::{DecodeError, check_version};

/// Number of bytes that hold the beginning of every valid trajectory: two tags, a version, a length, and a name.
pub const TRAJECTORY_HEADER_BYTES: usize = 96;

const MESSAGE: &str = "Trajectory";

/// Returns the actor that a trajectory names, from its first [`TRAJECTORY_HEADER_BYTES`] or more. Looks at nothing
/// else, so it takes the same few nanoseconds for every message.
///
/// # Errors
/// If the bytes do not begin with this protocol's version and a name, as [`super::encode_trajectory`] and every other
/// protobuf encoder write them.
pub fn trajectory_actor(mut bytes: &[u8]) -> Result<&str, DecodeError> {
    let malformed = |source| DecodeError::Malformed { message: MESSAGE, source };
    let tag = |bytes: &mut &[u8], wanted: (u32, WireType), field: &'static str| {
        if bytes.is_empty() || decode_key(bytes).map_err(malformed)? != wanted {
            return Err(DecodeError::Missing { field });
        }
        decode_varint(bytes).map_err(malformed)
    };
    let version = tag(&mut bytes, (1, WireType::Varint), "protocol_version")?;
    check_version(u32::try_from(version).unwrap_or(u32::MAX))?;
    let length = tag(&mut bytes, (2, WireType::LengthDelimited), "actor")?;
    let name = usize::try_from(length).ok().and_then(|length| bytes.get(..length));
    name.and_then(|name| str::from_utf8(name).ok()).ok_or(DecodeError::Missing { field: "actor" })
}

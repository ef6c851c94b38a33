//! Decoding errors.

/// Bytes that are not a valid message.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// The message exceeds the size limit of its kind and is not parsed, the sender has a different protocol version,
    /// or a value breaks a rule.
    #[error("{0}")]
    Invalid(String),
    /// The bytes are not protobuf, or not of the expected type.
    #[error("not a lodestone.v1.{0}: {1}")]
    Malformed(&'static str, prost::DecodeError),
    /// The bytes of a recording are not those that were written.
    #[error("its checksum is {0:016x}, and its bytes have {1:016x}")]
    Checksum(u64, u64),
    /// A required part is missing.
    #[error("{0} is missing")]
    Missing(&'static str),
}

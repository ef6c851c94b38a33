//! Decoding errors.

/// Bytes that are not a valid message.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// The message exceeds the size limit of its kind and is not parsed.
    #[error("{message} of {bytes} bytes is larger than the limit of {limit} bytes")]
    TooLarge {
        /// Name of the message.
        message: &'static str,
        /// Size of the message.
        bytes: usize,
        /// The largest size allowed.
        limit: usize,
    },
    /// The bytes are not protobuf, or not of the expected type.
    #[error("not a lodestone.v1.{message}: {source}")]
    Malformed {
        /// Name of the expected message.
        message: &'static str,
        /// The parser's error.
        source: prost::DecodeError,
    },
    /// The sender has a different protocol version.
    #[error(
        "it has protocol version {found}, and this process speaks version {expected}: run one version of Lodestone in \
         all processes"
    )]
    Version {
        /// Version in the message.
        found: u32,
        /// Version of this process.
        expected: u32,
    },
    /// The bytes of a recording are not those that were written.
    #[error("its checksum is {found:016x}, and its bytes have {expected:016x}")]
    Checksum {
        /// Checksum in the recording.
        found: u64,
        /// Checksum of its bytes.
        expected: u64,
    },
    /// A required part is missing.
    #[error("{field} is missing")]
    Missing {
        /// Path of the field.
        field: &'static str,
    },
    /// A value breaks a rule.
    #[error("{field} is {value}, expected {expected}")]
    Invalid {
        /// Path of the field.
        field: &'static str,
        /// The offending value, shortened if long.
        value: String,
        /// The rule.
        expected: &'static str,
    },
}

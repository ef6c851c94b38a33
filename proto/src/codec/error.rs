//! Why a message was not accepted.

/// The error of bytes that are not a valid message.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// Larger than any sane message of its kind; not even parsed.
    #[error("{message} of {bytes} bytes is larger than the limit of {limit} bytes")]
    TooLarge {
        /// Name of the message.
        message: &'static str,
        /// Its size.
        bytes: usize,
        /// The largest size allowed.
        limit: usize,
    },
    /// Not protobuf, or of another type.
    #[error("not a lodestone.v1.{message}: {source}")]
    Malformed {
        /// Name of the message expected.
        message: &'static str,
        /// What the parser says.
        source: prost::DecodeError,
    },
    /// From a process that speaks another version.
    #[error("protocol version {found} is not {expected}")]
    Version {
        /// Version in the message.
        found: u32,
        /// Version of this process.
        expected: u32,
    },
    /// A required part is not there.
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

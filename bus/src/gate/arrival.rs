//! A connection at the gate, and why it may be refused.

use std::io;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite};

/// An encrypted connection.
pub(super) trait Stream: AsyncRead + AsyncWrite + Send + Unpin {}

impl<S: AsyncRead + AsyncWrite + Send + Unpin> Stream for S {}

/// A process whose certificate is good.
pub(super) struct Arrived {
    pub(super) stream: Box<dyn Stream>,
    /// The role in its certificate.
    pub(super) role: String,
    /// How long both certificates are still valid.
    pub(super) valid_for: Duration,
    /// Of QUIC: dropping it cuts the stream.
    pub(super) connection: Option<quinn::Connection>,
}

/// Reasons why a connection does not become a member.
#[derive(Debug, thiserror::Error)]
pub(super) enum Refused {
    /// The connection broke, or TLS refused it.
    #[error("{0}")]
    Broken(#[from] io::Error),
    /// QUIC refused it.
    #[error("{0}")]
    Quic(#[from] quinn::ConnectionError),
    /// A certificate that names no role.
    #[error("its certificate names no role")]
    NoRole,
    /// A user that is not the certificate's role.
    #[error("it has the certificate of the role `{role}` and another user name")]
    Mixed { role: String },
    /// The router answered with a refusal.
    #[error("wrong password, or another version of zenoh, of the role `{role}`")]
    ByRouter { role: String },
}

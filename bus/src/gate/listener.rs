//! Public ports: QUIC over UDP, and TLS over TCP.

use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::time::Duration;

use quinn::crypto::rustls::QuicServerConfig;
use quinn::rustls::ServerConfig;
use quinn::{EndpointConfig, Incoming, TokioRuntime, VarInt};
use tokio::net::{TcpListener, TcpStream, lookup_host};
use tokio_rustls::TlsAcceptor;

use super::arrival::{Arrived, Refused};
use super::hall::Hall;
use super::tls;
use crate::BusError;
use crate::security::{Keys, address, is_tls};

/// What zenoh's QUIC clients may ask for. One stream for everything is what a Unix socket can carry on.
const PROTOCOLS: [&[u8]; 2] = [b"zenoh", b"hq-29"];

/// Pause after an error of the system, such as too many open files, which only time can mend.
const PAUSE: Duration = Duration::from_millis(100);

/// A bound port.
#[derive(Debug)]
pub(super) enum Listener {
    Tcp(TcpListener, Arc<ServerConfig>, Duration),
    Quic(quinn::Endpoint, Duration),
}

impl Listener {
    /// Binds `quic/HOST:PORT` or `tls/HOST:PORT`.
    pub(super) async fn bind(endpoint: &str, keys: &Keys) -> Result<Self, BusError> {
        let (mut config, valid_for) = tls::server(keys)?;
        let failed = |error: io::Error| BusError::during(format!("listening on {endpoint}"))(error.into());
        let (host, port) = address(endpoint).ok_or_else(|| failed(io::ErrorKind::InvalidInput.into()))?;
        let mut last = io::Error::from(io::ErrorKind::AddrNotAvailable);
        config.alpn_protocols = if is_tls(endpoint) { Vec::new() } else { PROTOCOLS.map(<[u8]>::to_vec).into() };
        let config = Arc::new(config);
        for at in lookup_host((host, port)).await.map_err(failed)? {
            let bound = if is_tls(endpoint) {
                TcpListener::bind(at).await.map(|socket| Self::Tcp(socket, Arc::clone(&config), valid_for))
            } else {
                quic_endpoint(at, &config).map(|endpoint| Self::Quic(endpoint, valid_for))
            };
            match bound {
                Ok(listener) => return Ok(listener),
                Err(error) => last = error,
            }
        }
        Err(failed(last))
    }

    /// Hands every connection to the hall, for as long as this is polled.
    pub(super) async fn admit(self, hall: &Arc<Hall>) {
        match self {
            Self::Tcp(socket, config, valid_for) => loop {
                match socket.accept().await {
                    Ok((stream, from)) => hall.receive(from, complete_tls(stream, Arc::clone(&config), valid_for)),
                    Err(error) => {
                        tracing::warn!(%error, "cannot accept connections");
                        tokio::time::sleep(PAUSE).await;
                    }
                }
            },
            Self::Quic(endpoint, valid_for) => {
                while let Some(incoming) = endpoint.accept().await {
                    if hall.is_crowded() && !incoming.remote_address_validated() {
                        // It fails only for an address that has been validated.
                        let _ = incoming.retry();
                    } else {
                        hall.receive(incoming.remote_address(), complete_quic(incoming, valid_for));
                    }
                }
            }
        }
    }

    /// The endpoint whose end would cut its connections.
    pub(super) fn quic(&self) -> Option<quinn::Endpoint> {
        match self {
            Self::Quic(endpoint, _) => Some(endpoint.clone()),
            Self::Tcp(..) => None,
        }
    }
}

async fn complete_tls(stream: TcpStream, config: Arc<ServerConfig>, valid_for: Duration) -> Result<Arrived, Refused> {
    stream.set_nodelay(true)?;
    let stream = TlsAcceptor::from(config).accept(stream).await?;
    let (role, valid_for) = tls::peer(stream.get_ref().1.peer_certificates(), valid_for).ok_or(Refused::NoRole)?;
    Ok(Arrived { stream: Box::new(stream), role, valid_for, connection: None })
}

async fn complete_quic(incoming: Incoming, valid_for: Duration) -> Result<Arrived, Refused> {
    let connection = incoming.accept()?.await?;
    let (to, from) = connection.accept_bi().await?;
    let identity = connection.peer_identity().and_then(|any| any.downcast().ok());
    let certificates: Option<Box<Vec<tls::Certificate>>> = identity;
    let (role, valid_for) =
        tls::peer(certificates.as_ref().map(|chain| &chain[..]), valid_for).ok_or(Refused::NoRole)?;
    let stream = Box::new(tokio::io::join(from, to));
    Ok(Arrived { stream, role, valid_for, connection: Some(connection) })
}

fn quic_endpoint(at: SocketAddr, config: &Arc<ServerConfig>) -> io::Result<quinn::Endpoint> {
    let crypto = QuicServerConfig::try_from(Arc::clone(config)).map_err(io::Error::other)?;
    let mut server = quinn::ServerConfig::with_crypto(Arc::new(crypto));
    let mut transport = quinn::TransportConfig::default();
    transport.max_concurrent_bidi_streams(VarInt::from_u32(1)).max_concurrent_uni_streams(VarInt::from_u32(0));
    server.transport_config(Arc::new(transport));
    let socket = UdpSocket::bind(at)?;
    quinn::Endpoint::new(EndpointConfig::default(), Some(server), socket, Arc::new(TokioRuntime))
}

//! A client's way to a router over TCP: zenoh connects to a Unix socket, and the tunnel goes on with TLS.

use std::io;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;
use quinn::rustls::pki_types::ServerName;
use tokio::net::{TcpStream, UnixListener, UnixStream};
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use super::relay::relay;
use super::tls;
use crate::BusError;
use crate::security::{Keys, address};

/// The other end of a tunnel.
struct Router {
    endpoint: String,
    host: String,
    port: u16,
    connector: TlsConnector,
    /// Time limit for a connection.
    limit: Duration,
    closing: CancellationToken,
    /// The last error, which is told once and not with every attempt.
    failing: Mutex<Option<String>>,
}

/// Opens a tunnel from the Unix socket at `entrance` to a router. It connects whenever zenoh does.
pub(super) fn open(
    endpoint: &str,
    entrance: &Path,
    keys: &Keys,
    limit: Duration,
    tasks: &TaskTracker,
    closing: &CancellationToken,
) -> Result<(), BusError> {
    let failed = |error: io::Error| BusError::during(format!("listening on {}", entrance.display()))(error.into());
    let (host, port) = address(endpoint).ok_or_else(|| failed(io::ErrorKind::InvalidInput.into()))?;
    let connector = TlsConnector::from(Arc::new(tls::client(keys)?));
    let endpoint = endpoint.to_owned();
    let host = host.to_owned();
    let failing = Mutex::new(None);
    let router = Arc::new(Router { endpoint, host, port, connector, limit, closing: closing.clone(), failing });
    let listener = UnixListener::bind(entrance).map_err(failed)?;
    let its_tasks = tasks.clone();
    tasks.spawn(closing.clone().run_until_cancelled_owned(async move {
        loop {
            match listener.accept().await {
                Ok((inner, _)) => drop(its_tasks.spawn(Arc::clone(&router).carry(inner))),
                Err(error) => {
                    tracing::warn!(%error, "cannot accept connections");
                    tokio::time::sleep(Duration::from_millis(100)).await;
                }
            }
        }
    }));
    Ok(())
}

impl Router {
    async fn carry(self: Arc<Self>, inner: UnixStream) {
        let connecting = tokio::time::timeout(self.limit, self.connect());
        let Some(connected) = self.closing.run_until_cancelled(connecting).await else { return };
        let late = |_| Err(io::Error::new(io::ErrorKind::TimedOut, "no answer"));
        match connected.unwrap_or_else(late) {
            Ok(outer) => {
                *self.failing.lock() = None;
                let certificates = outer.get_ref().1.peer_certificates();
                let valid_for = tls::peer(certificates, Duration::MAX).map_or(Duration::ZERO, |(_, valid)| valid);
                relay(outer, inner, valid_for).await;
            }
            Err(error) => {
                let error = error.to_string();
                let mut failing = self.failing.lock();
                if failing.as_ref() != Some(&error) {
                    tracing::warn!(endpoint = self.endpoint, error, "the router cannot be reached");
                    *failing = Some(error);
                }
            }
        }
    }

    async fn connect(&self) -> io::Result<TlsStream<TcpStream>> {
        let name = ServerName::try_from(self.host.clone()).map_err(io::Error::other)?;
        let stream = TcpStream::connect((self.host.as_str(), self.port)).await?;
        stream.set_nodelay(true)?;
        self.connector.connect(name, stream).await
    }
}

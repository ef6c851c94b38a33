//! Carries bytes between two connections.

use std::pin::pin;
use std::time::Duration;

use tokio::io::{self, AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::UnixStream;
use tokio::time::{sleep, timeout};

/// Bytes carried at once, in each direction of each connection.
const BUFFER: usize = 32 << 10;

/// When one direction has ended, the other gets this time to end.
pub(super) const LINGER: Duration = Duration::from_secs(1);

/// Carries bytes in both directions until one ends, or until a certificate expires.
pub(super) async fn relay(outer: impl AsyncRead + AsyncWrite, inner: UnixStream, valid_for: Duration) {
    let (from_outer, to_outer) = io::split(outer);
    let (from_inner, to_inner) = inner.into_split();
    let (mut inward, mut outward) = (pin!(carry(from_outer, to_inner)), pin!(carry(from_inner, to_outer)));
    // An error at either end means the same as its end.
    tokio::select! {
        _ = &mut inward => drop(timeout(LINGER, outward).await),
        _ = &mut outward => drop(timeout(LINGER, inward).await),
        () = sleep(valid_for) => tracing::info!("a certificate has expired; its connection ends"),
    }
}

async fn carry(mut from: impl AsyncRead + Unpin, mut to: impl AsyncWrite + Unpin) -> io::Result<()> {
    let mut buffer = vec![0; BUFFER];
    loop {
        let n_bytes = from.read(&mut buffer).await?;
        if n_bytes == 0 {
            return to.shutdown().await;
        }
        to.write_all(&buffer[..n_bytes]).await?;
        // TLS may keep the end of what was written.
        to.flush().await?;
    }
}

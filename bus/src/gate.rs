//! The public ports of a router with keys, and the way of its clients to them.
//!
//! zenoh's own QUIC listener completes one handshake after the other, so that one packet from a host that never answers
//! kept everybody out for 30 s. Its TLS link reads and writes one stream from two tasks without a lock (zenoh issue
//! 2557). Therefore the gate owns every encrypted TCP connection at both ends and the QUIC listener. It gives each
//! handshake a task and a time limit, checks who comes, and carries the bytes of those admitted to zenoh through a Unix
//! socket in a folder that only this user can enter.

mod arrival;
mod hall;
mod handshake;
mod listener;
mod relay;
mod tls;
mod tunnel;

use std::fs::Permissions;
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;
use quinn::VarInt;
use tempfile::TempDir;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use super::config::JOIN_TIMEOUT_MS;
use super::security::{Keys, is_tls};
use super::{BusConfig, BusError};
use hall::Hall;
pub use hall::JoinCounts;
use listener::Listener;

/// Time limit for connections to end after their session has closed.
const CLOSE_LIMIT: Duration = Duration::from_secs(1);

/// Longest path of a Unix socket, which the system stores in 108 bytes.
const MAX_SOCKET_PATH: usize = 107;

/// The gate of a session with keys.
#[derive(Debug)]
pub(super) struct Gate {
    listen: Vec<String>,
    connect: Vec<String>,
    hall: Arc<Hall>,
    /// Bound, and not yet admitting.
    listeners: Mutex<Vec<Listener>>,
    quic: Vec<quinn::Endpoint>,
    /// Holds the sockets, and goes with this.
    _room: TempDir,
    tasks: TaskTracker,
    closing: CancellationToken,
}

impl Gate {
    /// Returns what zenoh listens on and connects to instead of the public endpoints.
    pub(super) fn endpoints(&self) -> [&[String]; 2] {
        [&self.listen, &self.connect]
    }

    /// Binds the public endpoints of `config`, and opens tunnels to the endpoints that it connects to over TCP.
    /// Returns `None` if zenoh can do everything itself.
    pub(super) async fn prepare(config: &BusConfig, keys: &Keys) -> Result<Option<Self>, BusError> {
        let is_router = !config.listen.is_empty();
        if !is_router && !config.connect.iter().any(|endpoint| is_tls(endpoint)) {
            return Ok(None);
        }
        let (tasks, closing) = (TaskTracker::new(), CancellationToken::new());
        let limit = Duration::from_millis(JOIN_TIMEOUT_MS);
        let room = room()?;
        let inner = room.path().join("router");
        let mut listeners = Vec::new();
        for endpoint in &config.listen {
            listeners.push(Listener::bind(endpoint, keys).await?);
        }
        let mut connect = Vec::new();
        for (number, endpoint) in config.connect.iter().enumerate() {
            if !is_tls(endpoint) {
                connect.push(endpoint.clone());
                continue;
            }
            let socket = room.path().join(number.to_string());
            tunnel::open(endpoint, &socket, keys, limit, &tasks, &closing)?;
            connect.push(endpoint_of(&socket));
        }
        let listen = is_router.then(|| endpoint_of(&inner)).into_iter().collect();
        let hall = Arc::new(Hall::new(inner, limit, tasks.clone()));
        let quic = listeners.iter().filter_map(Listener::quic).collect();
        let listeners = Mutex::new(listeners);
        Ok(Some(Self { listen, connect, hall, listeners, quic, _room: room, tasks, closing }))
    }

    /// Begins to admit processes, as soon as zenoh listens.
    pub(super) fn open(&self) {
        for listener in self.listeners.lock().drain(..) {
            let hall = Arc::clone(&self.hall);
            let closing = self.closing.clone();
            self.tasks.spawn(async move { closing.run_until_cancelled(listener.admit(&hall)).await });
        }
    }

    /// What became of connections, if others can connect.
    pub(super) fn counts(&self) -> Option<JoinCounts> {
        (!self.listen.is_empty()).then(|| self.hall.counts())
    }

    /// Ends everything, after the session has closed: the rest of what it wrote still leaves.
    pub(super) async fn close(&self) {
        self.closing.cancel();
        self.hall.clear();
        self.tasks.close();
        // Those that do not end in time are cut.
        let _ = timeout(CLOSE_LIMIT, self.tasks.wait()).await;
        for endpoint in &self.quic {
            endpoint.close(VarInt::from_u32(0), &[]);
            let _ = timeout(CLOSE_LIMIT, endpoint.wait_idle()).await;
        }
    }
}

impl Drop for Gate {
    fn drop(&mut self) {
        self.closing.cancel();
    }
}

/// Makes the folder of the Unix sockets, which only this user can enter.
fn room() -> Result<TempDir, BusError> {
    let making = || format!("no folder for sockets can be made in {}", std::env::temp_dir().display());
    let unusable = |error: io::Error| BusError::during(making())(error.into());
    let private = Permissions::from_mode(0o700);
    let room = tempfile::Builder::new().prefix("lodestone-bus-").permissions(private).tempdir().map_err(unusable)?;
    // The longest name in it, with what zenoh adds for its lock.
    if room.path().join("router.lock").as_os_str().len() > MAX_SOCKET_PATH {
        let reason = "the path is too long for a Unix socket; set TMPDIR to a shorter one";
        return Err(unusable(io::Error::new(io::ErrorKind::InvalidFilename, reason)));
    }
    Ok(room)
}

fn endpoint_of(socket: &Path) -> String {
    format!("unixsock-stream/{}", socket.display())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nobody_else_enters_the_folder_of_sockets() {
        let room = room().unwrap();
        assert_eq!(room.path().metadata().unwrap().permissions().mode() & 0o777, 0o700);
    }
}

//! Opening and closing a session.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use parking_lot::Mutex;
use tokio::sync::oneshot;
use tokio::time::Instant;
use zenoh::Wait;

use super::gate::Gate;
use super::{BusConfig, BusError, BusMode, JoinCounts, Pulse};
use proto::metrics::BusCounts;
use proto::{Valid, keys};

/// Timeout of closing a session.
const CLOSE_LIMIT: Duration = Duration::from_secs(10);
/// The same for a client without a router, which has no peer to notify.
const CLOSE_LIMIT_ALONE: Duration = Duration::from_millis(250);

/// A session on the bus. Clones share it, and every object created from it keeps it open.
///
/// Needs tokio's multi-thread runtime. Close it before the runtime ends, so that others see at once that it left.
#[derive(Clone, Debug)]
pub struct Bus {
    pub(super) session: zenoh::Session,
    pub(super) config: Valid<BusConfig>,
    pub(super) counts: Arc<Mutex<BusCounts>>,
    /// Names given to senders of queries.
    pub(super) n_askers: Arc<AtomicU64>,
    pub(super) pulse: Pulse,
    pub(super) gate: Option<Arc<Gate>>,
    /// Time of the next query for a newest value.
    pub(super) next_query: Arc<Mutex<Instant>>,
}

impl Bus {
    /// Joins the bus; a client waits until its router is present. Dropping the future cancels at once, but leaves
    /// behind a thread that keeps trying; it holds neither the runtime nor the process.
    ///
    /// # Errors
    /// If an endpoint cannot be listened on, or the keys cannot be used.
    pub async fn open(config: &Valid<BusConfig>) -> Result<Self, BusError> {
        Self::open_within(&keys::namespace(&config.run), config).await
    }

    /// Like [`Self::open`], but all keys have the prefix `namespace` instead of the run's.
    pub(super) async fn open_within(namespace: &str, config: &Valid<BusConfig>) -> Result<Self, BusError> {
        check_clock(SystemTime::now())?;
        let credentials = config.read_keys()?;
        let gate = match &credentials {
            Some(keys) => Gate::prepare(config, keys).await?.map(Arc::new),
            None => None,
        };
        let zenoh_config = config
            .to_zenoh(namespace, credentials.as_ref(), gate.as_deref().map(Gate::endpoints))
            .map_err(BusError::during("configuring the bus"))?;
        let joining = || match &config.listen[..] {
            [] => format!("joining the bus at {}", config.connect.join(" and ")),
            listen => format!("listening on {}", listen.join(" and ")),
        };
        // Zenoh blocks its thread until it has joined. The runtime would wait for one of its own threads when it ends.
        let (result, opened) = oneshot::channel();
        std::thread::Builder::new()
            .name("joining".to_owned())
            .spawn(move || {
                // If nobody waits any more, this closes the session.
                drop(result.send(zenoh::open(zenoh_config).wait()));
            })
            .map_err(|error| BusError::during(joining())(error.into()))?;
        let opened = opened.await.map_err(|panic| BusError::during(joining())(panic.into()))?;
        let session = opened.map_err(BusError::during(joining()))?;
        if let Some(gate) = &gate {
            gate.open();
        }
        let config = config.clone();
        let counts = Arc::default();
        let n_askers = Arc::default();
        let pulse = Pulse::default();
        let next_query = Arc::new(Mutex::new(Instant::now()));
        Ok(Self { session, config, counts, n_askers, pulse, gate, next_query })
    }

    /// Opens a router that can only be reached through a Unix socket in `dir`, for tests.
    ///
    /// # Errors
    /// If the socket cannot be created.
    pub async fn isolated(dir: &Path) -> Result<Self, BusError> {
        Self::open(&BusConfig::isolated_router(dir)).await
    }

    /// Returns the number of messages that this session has dropped so far, by reason.
    pub fn counts(&self) -> BusCounts {
        *self.counts.lock()
    }

    /// Returns what became of the connections to this process, if it is a router with keys.
    pub fn joins(&self) -> Option<JoinCounts> {
        self.gate.as_ref()?.counts()
    }

    /// Returns the name of the run.
    pub fn run(&self) -> &str {
        &self.config.run
    }

    /// Returns the heartbeat of the service on this session.
    pub fn pulse(&self) -> &Pulse {
        &self.pulse
    }

    /// Counts weights that this process received but cannot use. Call it once for each.
    pub fn count_refused_weights(&self) {
        self.counts.lock().weights_refused_total += 1;
    }

    /// Returns whether this process reaches the others now: a router always does, a client while it has its router.
    pub async fn is_connected(&self) -> bool {
        self.config.mode == BusMode::Router || self.session.info().routers_zid().await.next().is_some()
    }

    /// Leaves the bus: queued messages are still sent, and the tokens and queryables disappear for other processes.
    ///
    /// If a session cannot end its tasks in time, this logs a warning and leaves it as it is: the process is about to
    /// end, and the others notice when the lease expires. This happens to a client that lost its router, because zenoh
    /// waits for the running attempt to reconnect.
    pub async fn close(&self) {
        let reached = self.is_connected().await;
        let limit = if reached { CLOSE_LIMIT } else { CLOSE_LIMIT_ALONE };
        match tokio::time::timeout(limit, self.session.close()).await {
            Ok(Ok(())) => {}
            Ok(Err(error)) => tracing::warn!(%error, "the session did not close cleanly"),
            Err(_) => tracing::warn!(reached, "the session did not close within {} s", limit.as_secs()),
        }
        if let Some(gate) = &self.gate {
            gate.close().await;
        }
    }
}

fn check_clock(now: SystemTime) -> Result<(), BusError> {
    if now < UNIX_EPOCH { Err(BusError::Clock) } else { Ok(()) }
}

/// Returns the milliseconds since 1970; 0 if the clock is earlier.
pub fn unix_ms() -> u64 {
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since_1970.as_millis()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_before_1970_is_refused() {
        assert!(check_clock(UNIX_EPOCH).is_ok());
        assert!(matches!(check_clock(UNIX_EPOCH - Duration::from_nanos(1)), Err(BusError::Clock)));
    }
}

//! Opening and closing a session.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use super::counters::BusCounters;
use super::{BusConfig, BusError, BusMode, Pulse};
use proto::metrics::BusCounts;

/// How long leaving may take.
const CLOSE_LIMIT: Duration = Duration::from_secs(10);
/// The same for a client without a router, which has nobody to send to or to say goodbye to.
const CLOSE_LIMIT_ALONE: Duration = Duration::from_secs(1);

/// A session on the bus; clones share it, and whatever it makes keeps it open.
///
/// Needs tokio's multi-thread runtime. Close it before the runtime ends: others then see at once that it left.
#[derive(Clone, Debug)]
pub struct Bus {
    pub(super) session: zenoh::Session,
    pub(super) config: Arc<BusConfig>,
    pub(super) counters: Arc<BusCounters>,
    pub(super) pulse: Pulse,
}

impl Bus {
    /// Joins the bus; a client waits until its router is there. Dropping the future gives up at once, but a thread of the
    /// runtime is then left behind that goes on trying.
    ///
    /// # Errors
    /// If the configuration breaks a rule, an endpoint makes no sense or cannot be listened on.
    pub async fn open(config: &BusConfig) -> Result<Self, BusError> {
        config.validate()?;
        let keys = config.read_keys()?;
        let zenoh_config = config.to_zenoh(keys.as_ref()).map_err(BusError::during("configuring the bus"))?;
        let joining =
            || format!("joining the bus (listening on {:?}, connecting to {:?})", config.listen, config.connect);
        // Zenoh blocks the thread that polls this until it has joined; on a task of its own it can be given up.
        let opening = tokio::spawn(async move { zenoh::open(zenoh_config).await });
        let opened = opening.await.map_err(|panic| BusError::during(joining())(panic.into()))?;
        let session = opened.map_err(BusError::during(joining()))?;
        Ok(Self { session, config: Arc::new(config.clone()), counters: Arc::default(), pulse: Pulse::default() })
    }

    /// Opens a router that is reached only through a unix socket in `dir`, for tests.
    ///
    /// # Errors
    /// If the socket cannot be made.
    pub async fn isolated(dir: &Path) -> Result<Self, BusError> {
        Self::open(&BusConfig::isolated_router(dir)).await
    }

    /// What this session dropped so far.
    pub fn counts(&self) -> BusCounts {
        self.counters.counts()
    }

    /// What this process is in the network.
    pub fn mode(&self) -> BusMode {
        self.config.mode
    }

    /// Where the service on this session shows that its work goes on.
    pub fn pulse(&self) -> &Pulse {
        &self.pulse
    }

    /// Counts weights that came over the bus and that this process does not act by; once for each.
    pub fn count_refused_weights(&self) {
        self.counters.weights_refused.add_one();
    }

    /// Whether this process reaches the others now: a router always, a client while it has its router.
    pub async fn is_connected(&self) -> bool {
        self.mode() == BusMode::Router || self.session.info().routers_zid().await.next().is_some()
    }

    /// Leaves the bus: what is queued is still sent, tokens and queryables vanish for the others.
    ///
    /// A session that cannot end its tasks in time is left as it is, with a warning: whoever closes is about to end, and
    /// the others notice when the lease is over. That is what happens to a client that has lost its router, because
    /// zenoh waits for the running attempt to reach it again.
    pub async fn close(&self) {
        let reached = self.is_connected().await;
        let limit = if reached { CLOSE_LIMIT } else { CLOSE_LIMIT_ALONE };
        match tokio::time::timeout(limit, self.session.close()).await {
            Ok(Ok(())) => {}
            Ok(Err(error)) => tracing::warn!(%error, "the bus was not left in an orderly way"),
            Err(_) => tracing::warn!(reached, "the bus was not left within {} s", limit.as_secs()),
        }
    }
}

/// The time now in milliseconds since 1970: tells a restarted process from its predecessor of the same name.
pub fn process_epoch_ms() -> u64 {
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since_1970.as_millis()).unwrap_or(u64::MAX)
}

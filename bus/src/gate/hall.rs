//! Connections that are not yet members: their number is bounded, each has its time, and all are counted.

use std::collections::BTreeMap;
use std::fmt;
use std::future::Future;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use tokio::task::AbortHandle;
use tokio_util::task::TaskTracker;

use super::arrival::{Arrived, Refused};
use super::handshake;
use super::relay::{LINGER, relay};

/// Most connections that wait at once. One more ends the oldest: an honest handshake takes milliseconds, so whoever
/// stands still loses the place.
const MAX_PENDING: usize = 1024;

/// From this number on, a QUIC client must show that it receives what is sent to its address.
const MANY_PENDING: usize = MAX_PENDING / 4;

/// Refusals are told at most this often.
const NOTICE_PERIOD: Duration = Duration::from_secs(60);

/// What became of the connections to a router with keys, since it started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct JoinCounts {
    /// Connections that are not yet members of the bus.
    pub n_pending: u64,
    /// Connections that became members.
    pub n_joined: u64,
    /// Connections that were turned away, for example without keys of this router, or that made room for newer ones.
    pub n_refused: u64,
    /// Connections that were dropped because they stood still.
    pub n_stalled: u64,
}

impl fmt::Display for JoinCounts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { n_pending, n_joined, n_refused, n_stalled } = self;
        write!(f, "joins: {n_joined} done, {n_pending} pending, {n_refused} refused, {n_stalled} stood still")
    }
}

/// Where connections wait.
#[derive(Debug)]
pub(super) struct Hall {
    /// The Unix socket of zenoh's router.
    router: PathBuf,
    /// The time of each connection.
    limit: Duration,
    tasks: TaskTracker,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    pending: BTreeMap<u64, AbortHandle>,
    n_arrived: u64,
    counts: JoinCounts,
    /// When a refusal was last told, and how many were not told since.
    last_notice: Option<Instant>,
    n_untold: u64,
}

impl Hall {
    pub(super) fn new(router: PathBuf, limit: Duration, tasks: TaskTracker) -> Self {
        Self { router, limit, tasks, state: Mutex::default() }
    }

    pub(super) fn counts(&self) -> JoinCounts {
        let state = self.state.lock();
        JoinCounts { n_pending: state.pending.len() as u64, ..state.counts }
    }

    pub(super) fn is_crowded(&self) -> bool {
        self.state.lock().pending.len() >= MANY_PENDING
    }

    /// Completes a handshake in a task of its own, and then carries the member's messages until either end is done.
    pub(super) fn receive(
        self: &Arc<Self>,
        from: SocketAddr,
        arrival: impl Future<Output = Result<Arrived, Refused>> + Send + 'static,
    ) {
        let hall = Arc::clone(self);
        // The lock is held until the task is registered, because the task may end at once.
        let mut state = self.state.lock();
        let id = state.n_arrived;
        state.n_arrived += 1;
        let task = self.tasks.spawn(async move {
            let entering = tokio::time::timeout(hall.limit, async {
                let mut arrived = arrival.await?;
                let inner = handshake::enter(&mut arrived, &hall.router).await?;
                Ok::<_, Refused>((arrived, inner))
            });
            let entered = entering.await;
            if hall.state.lock().pending.remove(&id).is_none() {
                // It was just turned away, and counted, for a newer one.
                return;
            }
            match entered {
                Ok(Ok((arrived, inner))) => {
                    hall.state.lock().counts.n_joined += 1;
                    tracing::debug!(%from, role = arrived.role, "joined");
                    relay(arrived.stream, inner, arrived.valid_for).await;
                    if let Some(connection) = arrived.connection {
                        // What was written last may still be on its way.
                        let _ = tokio::time::timeout(LINGER, connection.closed()).await;
                    }
                }
                Ok(Err(refused)) => hall.turn_away(from, &refused.to_string(), |counts| &mut counts.n_refused),
                Err(_) => hall.turn_away(from, "it stood still", |counts| &mut counts.n_stalled),
            }
        });
        state.pending.insert(id, task.abort_handle());
        if state.pending.len() > MAX_PENDING
            && let Some((_, oldest)) = state.pending.pop_first()
        {
            oldest.abort();
            state.counts.n_refused += 1;
        }
    }

    /// Ends every handshake in progress.
    pub(super) fn clear(&self) {
        for (_, task) in std::mem::take(&mut self.state.lock().pending) {
            task.abort();
        }
    }

    fn turn_away(&self, from: SocketAddr, reason: &str, counter: impl FnOnce(&mut JoinCounts) -> &mut u64) {
        let mut state = self.state.lock();
        *counter(&mut state.counts) += 1;
        if state.last_notice.is_some_and(|notice| notice.elapsed() < NOTICE_PERIOD) {
            state.n_untold += 1;
            return;
        }
        state.last_notice = Some(Instant::now());
        let n_others = std::mem::take(&mut state.n_untold);
        drop(state);
        tracing::warn!(%from, reason, n_others, "a connection did not join the bus");
    }
}

#[cfg(test)]
mod tests {
    use std::future::pending;

    use super::*;

    #[tokio::test]
    async fn one_too_many_ends_the_oldest() {
        let tasks = TaskTracker::new();
        let hall = Arc::new(Hall::new(PathBuf::new(), Duration::from_secs(600), tasks.clone()));
        let from = SocketAddr::from(([127, 0, 0, 1], 1));
        for _ in 0..MAX_PENDING + 2 {
            hall.receive(from, pending());
        }
        let counts = JoinCounts { n_pending: MAX_PENDING as u64, n_refused: 2, ..JoinCounts::default() };
        assert_eq!(hall.counts(), counts);
        let oldest = hall.state.lock().pending.keys().next().copied();
        assert_eq!(oldest, Some(2));
        hall.clear();
        tasks.close();
        tasks.wait().await;
        assert_eq!(hall.counts(), JoinCounts { n_pending: 0, ..counts });
    }
}

//! Forwards messages from the bus to a view of a run.

use std::time::{Duration, Instant};

use bus::{AliveWatch, Bus, BusError, MetricsSample};
use proto::Role;
use tokio_util::sync::CancellationToken;

use crate::run_view::{Roster, SessionState};

/// How often the router connection and the session's own counters are polled.
const PERIOD: Duration = Duration::from_secs(1);

/// An update from the bus.
pub(crate) enum News {
    /// Metrics, in order of arrival.
    Metrics(MetricsSample),
    /// State of the session, sent whenever it may have changed and at least once per `PERIOD`.
    Session(SessionState),
}

/// Passes every update to `tell`, with the time since `start`, until `shutdown` or until the bus closes.
///
/// # Errors
/// Returns an error if the session fails. If the router is unreachable, waits for it instead.
pub(crate) async fn follow(
    bus: &Bus,
    start: Instant,
    shutdown: &CancellationToken,
    mut tell: impl FnMut(News, Duration),
) -> Result<(), BusError> {
    let mut metrics = bus.metrics_subscriber("**").await?;
    let members = [bus.alive(Role::Actor).await?, bus.alive(Role::Learner).await?, bus.alive(Role::Evaluator).await?];
    let [mut actors, mut learners, mut evaluators] = members.each_ref().map(AliveWatch::watch);
    let mut n_before = 0;
    let mut period = tokio::time::interval(PERIOD);
    loop {
        tokio::select! {
            () = shutdown.cancelled() => return Ok(()),
            sample = metrics.recv() => {
                let Some(sample) = sample else { return Ok(()) };
                tell(News::Metrics(sample), start.elapsed());
                continue;
            }
            Ok(()) = actors.changed() => {}
            Ok(()) = learners.changed() => {}
            Ok(()) = evaluators.changed() => {}
            _ = period.tick() => {}
        }
        let is_connected = bus.is_connected().await;
        let roster = Roster {
            actors: actors.borrow_and_update().clone(),
            learners: learners.borrow_and_update().clone(),
            evaluators: evaluators.borrow_and_update().clone(),
        };
        let n_services = if is_connected { roster.learners.len() + roster.evaluators.len() } else { 0 };
        if n_services > n_before {
            // A service that has just reconnected may not publish for a long time.
            metrics.ask_latest().await?;
        }
        n_before = n_services;
        let counts = bus.counts();
        tell(News::Session(SessionState { is_connected, roster, counts }), start.elapsed());
    }
}

//! From the bus to whoever shows a run.

use std::time::{Duration, Instant};

use bus::{AliveWatch, Bus, BusError, MetricsSample};
use proto::Role;
use tokio_util::sync::CancellationToken;

use crate::run_view::{Roster, SessionState};

/// How often the router and the session's own counts are looked at.
const PERIOD: Duration = Duration::from_secs(1);

/// Samples that are told at most at a time.
const BATCH: usize = 256;

/// What the bus has to say.
pub(crate) enum News {
    /// Metrics that came, in this order; at least one.
    Metrics(Vec<MetricsSample>),
    /// How the session stands now, told whenever that may have changed and once in each period.
    Session(SessionState),
}

/// Tells all news, each with the time since `start`, until `shutdown` or until the bus is closed.
///
/// # Errors
/// If the session fails. A router that is not there yet, or no longer, is waited for.
pub(crate) async fn follow(
    bus: &Bus,
    start: Instant,
    shutdown: &CancellationToken,
    mut tell: impl FnMut(News, Duration),
) -> Result<(), BusError> {
    let mut metrics = bus.metrics_subscriber("**").await?;
    let members = [bus.alive(Role::Actor).await?, bus.alive(Role::Learner).await?, bus.alive(Role::Evaluator).await?];
    let [mut actors, mut learners, mut evaluators] = members.each_ref().map(AliveWatch::watch);
    let mut samples = Vec::new();
    let (mut was_connected, mut n_services) = (true, (0, 0));
    let mut period = tokio::time::interval(PERIOD);
    loop {
        tokio::select! {
            () = shutdown.cancelled() => return Ok(()),
            n_samples = metrics.recv_many(&mut samples, BATCH) => {
                if n_samples == 0 {
                    return Ok(());
                }
                tell(News::Metrics(std::mem::take(&mut samples)), start.elapsed());
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
        let (had, n_had) = (was_connected, n_services);
        (was_connected, n_services) = (is_connected, (roster.learners.len(), roster.evaluators.len()));
        if is_connected && (!had || n_services.0 > n_had.0 || n_services.1 > n_had.1) {
            // Whoever has come back may have nothing new to say for long.
            metrics.ask_latest().await?;
        }
        let counts = bus.counts();
        tell(News::Session(SessionState { is_connected, roster, counts }), start.elapsed());
    }
}

//! From the bus to the board.

use std::time::{Duration, Instant};

use bus::{AliveWatch, Bus, BusConfig, BusError};
use proto::Role;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use super::board::{Board, Roster};

/// How often the router and the session's own counts are looked at.
const PERIOD: Duration = Duration::from_secs(1);

/// Samples that are taken at most before the board is shown.
const BATCH: usize = 256;

/// Keeps `board` up to date until `shutdown`; times on it count from `start`.
///
/// # Errors
/// If an endpoint makes no sense or the session fails. A router that is not there yet, or no longer, is waited for.
pub(super) async fn follow(
    config: BusConfig,
    board: watch::Sender<Board>,
    start: Instant,
    shutdown: CancellationToken,
) -> Result<(), BusError> {
    let bus = tokio::select! {
        () = shutdown.cancelled() => return Ok(()),
        opened = Bus::open(&config) => opened?,
    };
    let ended = read(&bus, &board, start, &shutdown).await;
    bus.close().await;
    ended
}

async fn read(
    bus: &Bus,
    board: &watch::Sender<Board>,
    start: Instant,
    shutdown: &CancellationToken,
) -> Result<(), BusError> {
    let mut metrics = bus.metrics_subscriber("**").await?;
    let members = [bus.alive(Role::Actor).await?, bus.alive(Role::Learner).await?, bus.alive(Role::Evaluator).await?];
    let [mut actors, mut learners, mut evaluators] = members.each_ref().map(AliveWatch::watch);
    let mut samples = Vec::new();
    let (mut had_router, mut n_services) = (true, (0, 0));
    let mut period = tokio::time::interval(PERIOD);
    loop {
        tokio::select! {
            () = shutdown.cancelled() => return Ok(()),
            n_samples = metrics.recv_many(&mut samples, BATCH) => {
                if n_samples == 0 {
                    return Ok(());
                }
                let now = start.elapsed();
                board.send_modify(|board| samples.drain(..).for_each(|sample| board.take(&sample, now)));
                continue;
            }
            Ok(()) = actors.changed() => {}
            Ok(()) = learners.changed() => {}
            Ok(()) = evaluators.changed() => {}
            _ = period.tick() => {}
        }
        let has_router = bus.is_connected().await;
        let roster = Roster {
            actors: actors.borrow_and_update().clone(),
            n_learners: learners.borrow_and_update().len(),
            n_evaluators: evaluators.borrow_and_update().len(),
        };
        let (had, n_had) = (had_router, n_services);
        (had_router, n_services) = (has_router, (roster.n_learners, roster.n_evaluators));
        if has_router && (!had || n_services.0 > n_had.0 || n_services.1 > n_had.1) {
            // Subscribing asks for the latest again: whoever has come back may have nothing new to say for long.
            metrics = bus.metrics_subscriber("**").await?;
        }
        let now = start.elapsed();
        board.send_if_modified(|board| {
            let link = board.set_connected(has_router, now);
            // All tokens vanish with the router; that says nothing about who is alive.
            let roster = has_router && board.set_roster(&roster);
            let bus = board.set_bus(bus.counts());
            link || roster || bus
        });
    }
}

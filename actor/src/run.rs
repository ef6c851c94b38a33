//! The actor as a service: stepping threads, sending tasks, and a reporting task.

mod shared;
mod stepping;

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use anyhow::Context;
use bus::{Bus, BusError, MetricsPublisher, SendError, unix_ms};
use proto::metrics::{ActorMetrics, METRICS_SCHEMA_VERSION};
use proto::{Refusal, Role, Trajectory, keys};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use crate::setup::ActorSetup;
use shared::Shared;
pub use shared::Summary;
use stepping::step_worlds;

/// Maximum number of segments that wait for the learner's answer at once.
pub const N_OUTSTANDING: usize = 2;

/// Interval between publications of an actor's metrics.
pub const METRICS_PERIOD: Duration = Duration::from_secs(2);

/// Time over which an actor's speed is averaged.
const SPEED_WINDOW: Duration = Duration::from_secs(30);

/// Maximum time that shutdown waits for the backlog to be sent.
const DRAIN_TIMEOUT: Duration = Duration::from_secs(2);

/// Maximum number of attempts to send a segment that gets no answer.
const MAX_ATTEMPTS: usize = 3;

/// How long an actor waits for another process with its name.
const NAME_PATIENCE: Duration = if cfg!(test) { Duration::from_secs(1) } else { bus::NAME_PATIENCE };

/// Pause before retrying a learner whose mailbox is full or that reports the name as taken.
const RETRY_PAUSE: Duration = Duration::from_millis(50);

/// Pause before a segment that nobody acknowledged is sent again.
const NO_REPLY_PAUSE: Duration = Duration::from_millis(250);

/// Rolls out from the first weights until `shutdown`, then sends the remaining segments for up to 2 s.
///
/// Stepping continues while the learner is away, unless a full backlog pauses it. The run's seed, the actor's name, its
/// start time, and the version of the first weights determine tasks and actions. Unusable weights are counted, and the
/// previous ones stay in use. The metrics that go to the bus go to `metrics_sender` too.
///
/// # Errors
/// If the session fails at the start, the weights are of a run with other settings or for
/// another network, no task can be started, or another live actor has the same name and keeps it.
pub async fn run(
    setup: ActorSetup,
    bus: &Bus,
    metrics_sender: watch::Sender<Option<ActorMetrics>>,
    shutdown: CancellationToken,
) -> anyhow::Result<Summary> {
    let ActorSetup { config, id, .. } = &setup;
    let declaring = bus.declare_alive_alone(Role::Actor, id.as_str(), NAME_PATIENCE);
    let Some(alive) = shutdown.run_until_cancelled(declaring).await else { return Ok(Summary::default()) };
    let _alive = alive?;
    // Distinguishes a restarted actor from its predecessor.
    let epoch = unix_ms();
    tracing::info!(actor = %id, epoch, seed = setup.seed, "actor starts");
    let subscriber = bus.weights_subscriber().await?;
    let sender = bus.trajectory_sender(id).await?;
    let metrics = bus.metrics_publisher(&keys::metrics_actor(id)).await?;
    let mut weights = subscriber.watch();
    let waiting = bus.pulse().waiting();
    if weights.borrow().is_none() {
        tracing::info!(actor = %id, "waiting for the first weights, which a learner of the run publishes");
    }
    let first = async { weights.wait_for(Option::is_some).await.map(drop) };
    let Some(first) = shutdown.run_until_cancelled(first).await else { return Ok(Summary::default()) };
    first.context("the bus closed before the first weights")?;
    drop(waiting);
    tracing::info!(actor = %id, n_threads = config.n_threads, n_worlds = config.n_worlds, "stepping");

    let shared = Arc::new(Shared::new(&setup, sender, bus, &shutdown));
    // Dropping this guard ends the reporter on every return path.
    let uncounted = shared.counted.clone().drop_guard();
    let n_worlds = (config.n_threads * config.n_worlds) as u64;
    let reporting = tokio::spawn(report_metrics(shared.clone(), metrics, metrics_sender, epoch, n_worlds));
    let mut senders = JoinSet::new();
    for _ in 0..N_OUTSTANDING {
        senders.spawn(send_all(shared.clone()));
    }
    let mut threads = JoinSet::new();
    for thread_idx in 0..config.n_threads {
        let (setup, weights, shared) = (setup.clone(), weights.clone(), shared.clone());
        threads.spawn_blocking(move || step_worlds(setup, epoch, weights, &shared, thread_idx));
    }

    let stepped = shared.stop_with_first(&mut threads).await;
    let n_unsent = drain(&shared, senders).await;
    drop(uncounted);
    reporting.await.context("the task that reports metrics failed")?;
    let report = shared.report();
    tracing::info!(actor = %id, env_steps = report.counters.n_env_steps, n_unsent, "actor ends");
    stepped?;
    if shared.lost_name.load(Ordering::Relaxed) {
        return Err(BusError::NameTaken(Role::Actor, id.as_str().to_owned()).into());
    }
    Ok(report)
}

/// Waits until the backlog is sent, but not for long, and counts what is left. Returns how much that is.
async fn drain(shared: &Shared, mut senders: JoinSet<()>) -> u64 {
    let drained = tokio::time::timeout(DRAIN_TIMEOUT, async { while senders.join_next().await.is_some() {} });
    if drained.await.is_err() {
        shared.give_up.cancel();
        while senders.join_next().await.is_some() {}
    }
    // Some may have arrived after the senders ended.
    let n_unsent = shared.backlog.clear();
    let mut dropped = shared.dropped.lock();
    let counter = match shared.lost_name.load(Ordering::Relaxed) {
        true => &mut dropped.name_taken_total,
        false => &mut dropped.no_learner_total,
    };
    *counter += n_unsent;
    n_unsent
}

/// Sends segments, oldest first, until the backlog is closed and empty.
async fn send_all(shared: Arc<Shared>) {
    while let Some(segment) = shared.backlog.pop().await {
        let sent = shared.give_up.run_until_cancelled(send(&shared, &segment)).await;
        if sent == Some(Sent::Done) {
            continue;
        }
        shared.count_shed(shared.backlog.put_back(segment));
        let paused = match sent {
            Some(Sent::Busy) => shared.give_up.run_until_cancelled(tokio::time::sleep(RETRY_PAUSE)).await,
            Some(Sent::NobodyThere) => shared.stop.run_until_cancelled(shared.sender.wait_for_learner()).await,
            Some(Sent::Done) | None => None,
        };
        if paused.is_none() {
            return;
        }
    }
}

/// Result of an attempt to send.
#[derive(PartialEq)]
enum Sent {
    /// Acknowledged, or dropped and counted.
    Done,
    /// Retry soon.
    Busy,
    /// Retry when a learner is present.
    NobodyThere,
}

async fn send(shared: &Shared, segment: &Trajectory) -> Sent {
    for _ in 0..MAX_ATTEMPTS {
        match shared.sender.send(segment).await {
            Ok(newest) => {
                shared.n_acked.fetch_add(1, Ordering::Relaxed);
                shared.learner_version.store(newest.0, Ordering::Relaxed);
                *shared.name_taken_since.lock() = None;
                return Sent::Done;
            }
            // A router that restarts takes a moment.
            Err(SendError::NoReply) => tokio::time::sleep(NO_REPLY_PAUSE).await,
            Err(SendError::NoLearner) => return Sent::NobodyThere,
            Err(SendError::Refused(Refusal::Full)) => return Sent::Busy,
            Err(SendError::Refused(Refusal::NameTaken)) => {
                shared.name_is_taken(NAME_PATIENCE);
                return Sent::Busy;
            }
            Err(SendError::Refused(Refusal::Stale)) => {
                shared.dropped.lock().stale_total += 1;
                return Sent::Done;
            }
            Err(error) => {
                tracing::warn!(seq = segment.seq, %error, "segment dropped");
                let mut drops = shared.dropped.lock();
                match error {
                    SendError::Refused(_) => drops.invalid_total += 1,
                    SendError::TooLarge(_) => drops.too_large_total += 1,
                    _ => drops.failed_total += 1,
                }
                return Sent::Done;
            }
        }
    }
    shared.dropped.lock().no_reply_total += 1;
    Sent::Done
}

/// Publishes the actor's metrics until all segments are accounted for.
async fn report_metrics(
    shared: Arc<Shared>,
    publisher: MetricsPublisher,
    metrics_sender: watch::Sender<Option<ActorMetrics>>,
    epoch: u64,
    n_worlds: u64,
) {
    let start = Instant::now();
    let mut reports = VecDeque::new();
    loop {
        let more = shared.counted.run_until_cancelled(tokio::time::sleep(METRICS_PERIOD)).await.is_some();
        let elapsed = start.elapsed();
        let Summary { counters, n_trajectories_acked, dropped } = shared.report();
        // The oldest version, so that a thread that falls behind is visible.
        let weights_version = shared.progress.lock().iter().map(|p| p.version).min().unwrap_or_default();
        let learner_version = shared.learner_version.load(Ordering::Relaxed);
        let metrics = ActorMetrics {
            schema_version: METRICS_SCHEMA_VERSION,
            actor: shared.actor.clone(),
            epoch,
            weights_version,
            elapsed_s: elapsed.as_secs_f64(),
            n_worlds,
            n_env_steps: counters.n_env_steps,
            env_steps_per_s: steps_per_s(&mut reports, elapsed, counters.n_env_steps),
            n_episodes: counters.n_episodes,
            policy_lag: learner_version.saturating_sub(weights_version.0),
            n_trajectories_acked,
            dropped,
            learner_is_there: shared.sender.learner_is_there(),
            bus: shared.bus.counts(),
        };
        if let Err(error) = publisher.put(&metrics).await {
            tracing::debug!(%error, "metrics not published");
        }
        metrics_sender.send_replace(Some(metrics));
        if !more {
            return;
        }
    }
}

/// Adds a report, and returns the steps per second over the last half minute: an actor that the learner keeps waiting
/// steps in bursts, between which a shorter time would say 0.
///
/// `reports`, empty at first, has the time since the start and the steps until then, of the reports in that half minute
/// and the last one before.
fn steps_per_s(reports: &mut VecDeque<(Duration, u64)>, elapsed: Duration, n_env_steps: u64) -> f64 {
    if reports.is_empty() {
        reports.push_back((Duration::ZERO, 0));
    }
    while reports.get(1).is_some_and(|(at, _)| *at + SPEED_WINDOW <= elapsed) {
        reports.pop_front();
    }
    let (since, before) = reports[0];
    reports.push_back((elapsed, n_env_steps));
    (n_env_steps - before) as f64 / (elapsed - since).as_secs_f64().max(1e-9)
}

#[cfg(test)]
mod tests;

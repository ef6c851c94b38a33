//! One simulated actor.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use actor::METRICS_PERIOD;
use anyhow::Context;
use bus::{AliveToken, Bus, MetricsPublisher, SendError, TrajectorySender, WeightsSubscriber, unix_ms};
use proto::metrics::{ActorDrops, ActorMetrics, BusCounts, METRICS_SCHEMA_VERSION};
use proto::{ActorId, Refusal, Role, Trajectory, WeightsVersion, keys};
use tokio::sync::watch;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use super::script::Script;
use super::tally::{LoadCounts, Tally};
use crate::actors::weights::Moment;

/// Pause before retrying a learner whose mailbox is full, as in a real actor.
const RETRY_PAUSE: Duration = Duration::from_millis(50);

/// A simulated actor on the bus.
#[derive(Debug)]
pub(super) struct Member {
    number: usize,
    id: ActorId,
    epoch: u64,
    bus: Bus,
    sender: TrajectorySender,
    /// Version and hash of the settings.
    weights: WeightsSubscriber<(WeightsVersion, u64)>,
    metrics: MetricsPublisher,
    _alive: AliveToken,
    next_seq: AtomicU64,
}

impl Member {
    /// Declares everything that an actor declares.
    pub(super) async fn join(number: usize, bus: Bus) -> anyhow::Result<Self> {
        let id = ActorId::try_from(format!("load-{number}")).context("naming a simulated actor")?;
        Ok(Self {
            number,
            epoch: unix_ms(),
            _alive: bus.declare_alive(Role::Actor, id.as_str()).await?,
            // Thousands of sessions in one process cannot hold all weights.
            weights: bus.weights_subscriber_keeping(|weights| Some((weights.version, weights.settings.hash()))).await?,
            sender: bus.trajectory_sender(&id).await?,
            metrics: bus.metrics_publisher(&keys::metrics_actor(&id)).await?,
            next_seq: AtomicU64::new(0),
            id,
            bus,
        })
    }

    pub(super) fn number(&self) -> usize {
        self.number
    }

    pub(super) fn counts(&self) -> BusCounts {
        self.bus.counts()
    }

    pub(super) async fn first_weights(&self) -> anyhow::Result<()> {
        self.weights.watch().wait_for(Option::is_some).await.context("the bus closed before the first weights")?;
        Ok(())
    }

    pub(super) async fn close(&self) {
        self.bus.close().await;
    }

    /// Sends segments as they become due until `stop`.
    pub(super) async fn send_all(
        &self,
        script: &Script,
        start: Instant,
        tally: &Tally,
        stop: &CancellationToken,
        give_up: &CancellationToken,
    ) {
        let weights = self.weights.watch();
        while !stop.is_cancelled() {
            let seq = self.next_seq.fetch_add(1, Ordering::Relaxed);
            let since = match script.due(seq).map(|due| start + due) {
                Some(due) => tokio::select! {
                    () = tokio::time::sleep_until(due) => due,
                    () = stop.cancelled() => return,
                },
                None => Instant::now(),
            };
            let (weights_version, settings_hash) = newest(&weights);
            let actor = self.id.clone();
            let epoch = self.epoch;
            let segment =
                Trajectory { actor, epoch, seq, weights_version, settings_hash, ..script.segment(seq).clone() };
            self.deliver(&segment, script.n_bytes(seq), since, tally, give_up).await;
        }
    }

    /// Sends one segment until it gets a final answer.
    async fn deliver(
        &self,
        segment: &Trajectory,
        n_bytes: usize,
        since: Instant,
        tally: &Tally,
        give_up: &CancellationToken,
    ) {
        // Whether an attempt got no answer, so that the learner may have the segment.
        let mut in_doubt = false;
        let refused = |count: fn(&mut LoadCounts), in_doubt: bool| {
            let doubt: fn(&mut LoadCounts) = |counts| counts.in_doubt_total += 1;
            tally.count(if in_doubt { doubt } else { count });
        };
        loop {
            let sent = tokio::select! {
                sent = self.sender.send(segment) => sent,
                () = give_up.cancelled() => return tally.count(|counts| counts.in_doubt_total += 1),
            };
            let pause = match sent {
                Ok(_) => return tally.count_acked(segment, n_bytes, since.elapsed()),
                Err(SendError::Refused(Refusal::Stale)) => return refused(|counts| counts.stale_total += 1, in_doubt),
                Err(SendError::Refused(Refusal::Full)) => {
                    tally.count(|counts| counts.full_total += 1);
                    RETRY_PAUSE
                }
                Err(SendError::NoReply) => {
                    tally.count(|counts| counts.no_reply_total += 1);
                    in_doubt = true;
                    Duration::ZERO
                }
                Err(SendError::NoLearner) => {
                    tally.count(|counts| counts.no_learner_total += 1);
                    tokio::select! {
                        () = self.sender.wait_for_learner() => Duration::ZERO,
                        () = give_up.cancelled() => return refused(|counts| counts.unsent_total += 1, in_doubt),
                    }
                }
                Err(error) => {
                    let is_refused = matches!(error, SendError::Refused(_));
                    tally.count(|counts| {
                        counts.first_error.get_or_insert_with(|| error.to_string());
                    });
                    let count: fn(&mut LoadCounts) =
                        if is_refused { |counts| counts.invalid_total += 1 } else { |counts| counts.failed_total += 1 };
                    return refused(count, in_doubt);
                }
            };
            tokio::select! {
                () = tokio::time::sleep(pause) => {}
                () = give_up.cancelled() => return refused(|counts| counts.unsent_total += 1, in_doubt),
            }
        }
    }

    /// Publishes metrics as an actor does and records when newer weights arrived, until `end`.
    pub(super) async fn watch_and_report(&self, tally: &Tally, end: &CancellationToken) -> Vec<Moment> {
        let mut weights = self.weights.watch();
        weights.mark_unchanged();
        let start = Instant::now();
        let mut next = start + METRICS_PERIOD;
        let mut pulls = vec![Moment::now(newest(&weights).0)];
        loop {
            tokio::select! {
                () = end.cancelled() => return pulls,
                changed = weights.changed() => {
                    if changed.is_err() { return pulls }
                    pulls.push(Moment::now(newest(&weights).0));
                }
                () = tokio::time::sleep_until(next) => {
                    next += METRICS_PERIOD;
                    let metrics = self.metrics_now(&tally.copy(), newest(&weights).0, start.elapsed());
                    if let Err(error) = self.metrics.put(&metrics).await {
                        tracing::debug!(%error, "metrics not published");
                    }
                }
            }
        }
    }

    fn metrics_now(&self, counts: &LoadCounts, weights_version: WeightsVersion, elapsed: Duration) -> ActorMetrics {
        ActorMetrics {
            schema_version: METRICS_SCHEMA_VERSION,
            actor: self.id.clone(),
            epoch: self.epoch,
            weights_version,
            elapsed_s: elapsed.as_secs_f64(),
            n_worlds: 1,
            n_env_steps: counts.acked_steps_total,
            env_steps_per_s: counts.acked_steps_total as f64 / elapsed.as_secs_f64().max(1e-9),
            n_episodes: 0,
            policy_lag: 0,
            n_trajectories_acked: counts.acked_total,
            dropped: ActorDrops { stale_total: counts.stale_total, ..ActorDrops::default() },
            learner_is_there: self.sender.learner_is_there(),
            bus: self.bus.counts(),
        }
    }
}

/// Returns the version of the newest weights and the hash of their settings.
fn newest(weights: &watch::Receiver<Option<Arc<(WeightsVersion, u64)>>>) -> (WeightsVersion, u64) {
    weights.borrow().as_deref().copied().unwrap_or_default()
}

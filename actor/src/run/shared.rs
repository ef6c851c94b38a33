//! What the threads and tasks of an actor share.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use anyhow::Context;
use bus::{Bus, TrajectorySender};
use parking_lot::Mutex;
use policy::PolicyError;
use proto::metrics::ActorDrops;
use proto::{ActorId, Weights, WeightsVersion};
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use crate::backlog::Backlog;
use crate::rollout::RolloutCounters;
use crate::setup::ActorSetup;

/// Results of an actor process.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Summary {
    /// Counts of all threads.
    pub counters: RolloutCounters,
    /// Segments that the learner acknowledged.
    pub n_trajectories_acked: u64,
    /// Segments that were dropped, by reason.
    pub dropped: ActorDrops,
}

/// State shared by threads and tasks.
pub(super) struct Shared {
    pub(super) backlog: Backlog,
    pub(super) sender: TrajectorySender,
    pub(super) dropped: Mutex<ActorDrops>,
    pub(super) n_acked: AtomicU64,
    /// Version of the learner's weights in its last answer.
    pub(super) learner_version: AtomicU64,
    /// One per thread.
    pub(super) progress: Mutex<Vec<Progress>>,
    pub(super) bus: Bus,
    /// Refused weights that a thread may refuse again, so that weights refused by several threads count once.
    pub(super) refused: Mutex<Vec<Weak<Weights>>>,
    pub(super) actor: ActorId,
    /// Time since which the learner reports that another process owns the actor's name.
    pub(super) name_taken_since: Mutex<Option<Instant>>,
    /// Whether the learner has reported this for too long.
    pub(super) lost_name: AtomicBool,
    /// Canceled to stop stepping.
    pub(super) stop: CancellationToken,
    /// Canceled to stop sending as well.
    pub(super) give_up: CancellationToken,
    /// Canceled when all segments are accounted for.
    pub(super) counted: CancellationToken,
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Progress {
    pub(super) counters: RolloutCounters,
    pub(super) version: WeightsVersion,
}

impl Shared {
    pub(super) fn new(setup: &ActorSetup, sender: TrajectorySender, bus: &Bus, shutdown: &CancellationToken) -> Self {
        let ActorSetup { config, id, .. } = setup;
        Self {
            backlog: Backlog::new(config.backlog_limit, config.full_backlog),
            sender,
            dropped: Mutex::default(),
            n_acked: AtomicU64::new(0),
            learner_version: AtomicU64::new(0),
            progress: Mutex::new(vec![Progress::default(); config.n_threads]),
            bus: bus.clone(),
            refused: Mutex::default(),
            actor: id.clone(),
            name_taken_since: Mutex::default(),
            lost_name: AtomicBool::new(false),
            stop: shutdown.child_token(),
            give_up: CancellationToken::new(),
            counted: CancellationToken::new(),
        }
    }

    /// Waits for `stop` or the end of the first thread, then ends the other threads and closes the backlog.
    pub(super) async fn stop_with_first(&self, threads: &mut JoinSet<anyhow::Result<()>>) -> anyhow::Result<()> {
        let first = self.stop.run_until_cancelled(threads.join_next()).await.flatten();
        self.stop.cancel();
        // Wakes threads that pause for room.
        self.backlog.close();
        let mut ended: Vec<_> = first.into_iter().collect();
        while let Some(thread) = threads.join_next().await {
            ended.push(thread);
        }
        ended.into_iter().try_for_each(|thread| thread.context("a stepping thread panicked")?)
    }

    /// Counts unusable weights.
    pub(super) fn refuse(&self, weights: &Arc<Weights>, error: &PolicyError) {
        let mut refused = self.refused.lock();
        refused.retain(|known| known.strong_count() > 0);
        let weak = Arc::downgrade(weights);
        if !refused.iter().any(|known| known.ptr_eq(&weak)) {
            refused.push(weak);
            self.bus.count_refused_weights();
            tracing::warn!(version = weights.version.0, %error, "weights refused");
        }
    }

    /// Records that the learner assigns the name to another process, and stops the actor if this lasts for `patience`.
    pub(super) fn name_is_taken(&self, patience: Duration) {
        let mut since = self.name_taken_since.lock();
        let since = since.get_or_insert_with(|| {
            tracing::warn!(actor = %self.actor, "the learner says that another live actor has this name");
            Instant::now()
        });
        if since.elapsed() >= patience {
            self.lost_name.store(true, Ordering::Relaxed);
            self.stop.cancel();
            self.give_up.cancel();
        }
    }

    /// Counts segments dropped for lack of room.
    pub(super) fn count_shed(&self, n_dropped: u64) {
        if n_dropped > 0 && self.sender.learner_is_there() {
            self.dropped.lock().full_total += n_dropped;
        } else {
            self.dropped.lock().no_learner_total += n_dropped;
        }
    }

    pub(super) fn report(&self) -> Summary {
        let mut counters = RolloutCounters::default();
        self.progress.lock().iter().for_each(|progress| counters += progress.counters);
        let mut dropped = *self.dropped.lock();
        dropped.diverged_total = counters.n_diverged_episodes;
        Summary { counters, n_trajectories_acked: self.n_acked.load(Ordering::Relaxed), dropped }
    }
}

//! What became of the segments, counted at the actors' end.

use parking_lot::{Mutex, MutexGuard};
use std::time::Duration;

use proto::Trajectory;
use serde::{Deserialize, Serialize};

use super::Histogram;

/// What became of segments. Each one that was begun is in exactly one of `acked_total`, `stale_total`, `invalid_total`,
/// `failed_total`, `in_doubt_total` and `unsent_total`; the others count attempts.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoadCounts {
    /// The learner acknowledged it.
    pub acked_total: u64,
    /// Steps of those.
    pub acked_steps_total: u64,
    /// Encoded bytes of those.
    pub acked_bytes_total: u64,
    /// Wrapping sum of [`Trajectory::fingerprint`] of those.
    pub acked_fingerprints: u64,
    /// The learner called it too old.
    pub stale_total: u64,
    /// The learner called it invalid.
    pub invalid_total: u64,
    /// The session refused it.
    pub failed_total: u64,
    /// The end came before an answer: the learner may have it.
    pub in_doubt_total: u64,
    /// The end came while it waited for another attempt: the learner does not have it.
    pub unsent_total: u64,
    /// Attempts that found mailbox or queue full.
    pub full_total: u64,
    /// Attempts that nobody answered in time.
    pub no_reply_total: u64,
    /// Attempts while no learner was there.
    pub no_learner_total: u64,
    /// Time from when a segment was due, or at full speed from its first attempt, to its acknowledgement.
    pub ack_latency: Histogram,
    /// The first failure of the session.
    pub first_error: Option<String>,
}

/// When an actor had which weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pull {
    /// The version.
    pub version: u64,
    /// Microseconds since 1970.
    pub unix_us: u64,
}

/// What the actors of one process did.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoadReport {
    /// Actors that took part.
    pub n_actors: usize,
    /// Time from the start to the stop.
    pub elapsed_s: f64,
    /// Whether every attempt had its answer before the end.
    pub drained: bool,
    /// Of all actors together.
    pub counts: LoadCounts,
    /// The weights of each actor, oldest first, from those on that it held at the start.
    pub pulls: Vec<Vec<Pull>>,
    /// Pulls of weights that failed and were tried again.
    pub pulls_failed_total: u64,
    /// Weights that could not be read.
    pub weights_invalid_total: u64,
}

impl LoadCounts {
    /// Adds what another process or actor counted.
    pub fn add(&mut self, other: &Self) {
        let Self { acked_total, acked_steps_total, acked_bytes_total, acked_fingerprints, .. } = other;
        add(&mut self.acked_total, *acked_total);
        add(&mut self.acked_steps_total, *acked_steps_total);
        add(&mut self.acked_bytes_total, *acked_bytes_total);
        self.acked_fingerprints = self.acked_fingerprints.wrapping_add(*acked_fingerprints);
        add(&mut self.stale_total, other.stale_total);
        add(&mut self.invalid_total, other.invalid_total);
        add(&mut self.failed_total, other.failed_total);
        add(&mut self.in_doubt_total, other.in_doubt_total);
        add(&mut self.unsent_total, other.unsent_total);
        add(&mut self.full_total, other.full_total);
        add(&mut self.no_reply_total, other.no_reply_total);
        add(&mut self.no_learner_total, other.no_learner_total);
        self.ack_latency.merge(&other.ack_latency);
        self.first_error = self.first_error.take().or_else(|| other.first_error.clone());
    }
}

pub(super) fn add(sum: &mut u64, n: u64) {
    *sum = sum.saturating_add(n);
}

/// The counts of one actor, shared by its tasks.
#[derive(Debug, Default)]
pub(super) struct Tally(Mutex<LoadCounts>);

impl Tally {
    pub(super) fn count(&self, change: impl FnOnce(&mut LoadCounts)) {
        change(&mut self.lock());
    }

    pub(super) fn count_acked(&self, segment: &Trajectory, n_bytes: usize, latency: Duration) {
        let mut counts = self.lock();
        counts.acked_total += 1;
        counts.acked_steps_total += segment.transitions.len() as u64;
        counts.acked_bytes_total += n_bytes as u64;
        counts.acked_fingerprints = counts.acked_fingerprints.wrapping_add(segment.fingerprint());
        counts.ack_latency.add(latency);
    }

    pub(super) fn copy(&self) -> LoadCounts {
        self.lock().clone()
    }

    pub(super) fn take(&self) -> LoadCounts {
        std::mem::take(&mut self.lock())
    }

    fn lock(&self) -> MutexGuard<'_, LoadCounts> {
        // Numbers are whole after every statement.
        self.0.lock()
    }
}

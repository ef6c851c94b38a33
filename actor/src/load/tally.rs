//! Results of the segments, counted by the actors.

use parking_lot::{Mutex, MutexGuard};
use std::time::Duration;

use proto::Trajectory;
use serde::{Deserialize, Serialize};

use super::Histogram;

/// Results of segments. Each segment that was started is in exactly one of `acked_total`, `stale_total`,
/// `invalid_total`, `failed_total`, `in_doubt_total`, and `unsent_total`. `full_total`, `no_reply_total`, and
/// `no_learner_total` count attempts.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoadCounts {
    /// Segments that the learner acknowledged.
    pub acked_total: u64,
    /// Steps of the acknowledged segments.
    pub acked_steps_total: u64,
    /// Encoded bytes of the acknowledged segments.
    pub acked_bytes_total: u64,
    /// Wrapping sum of [`Trajectory::fingerprint`] over the acknowledged segments.
    pub acked_fingerprints: u64,
    /// Segments that the learner refused as stale.
    pub stale_total: u64,
    /// Segments that the learner refused as invalid, or because the name is taken.
    pub invalid_total: u64,
    /// Segments that the session failed to send.
    pub failed_total: u64,
    /// Segments that the learner may have, because an attempt got no answer.
    pub in_doubt_total: u64,
    /// Segments that still waited for another attempt at the end; the learner does not have them.
    pub unsent_total: u64,
    /// Attempts that found the learner's mailbox or queue full.
    pub full_total: u64,
    /// Attempts without an answer in time.
    pub no_reply_total: u64,
    /// Attempts while no learner was present.
    pub no_learner_total: u64,
    /// Time from when a segment was due, or at full speed from its first attempt, to its acknowledgment.
    pub ack_latency: Histogram,
    /// The first failure of the session.
    pub first_error: Option<String>,
}

/// When an actor received which weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pull {
    /// The version.
    pub version: u64,
    /// Microseconds since 1970.
    pub unix_us: u64,
}

/// Results of the actors of one process.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoadReport {
    /// Actors that took part.
    pub n_actors: usize,
    /// Time from start to stop, in seconds.
    pub elapsed_s: f64,
    /// Whether every attempt was answered before the end.
    pub drained: bool,
    /// Counts of all actors together.
    pub counts: LoadCounts,
    /// The weights of each actor, oldest first, beginning with those that it held at the start.
    pub pulls: Vec<Vec<Pull>>,
    /// Pulls of weights that failed and were retried.
    pub pulls_failed_total: u64,
    /// Weights that could not be decoded.
    pub weights_invalid_total: u64,
}

impl LoadCounts {
    /// Adds the counts of another process or actor.
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
        // Every statement leaves the counts consistent.
        self.0.lock()
    }
}

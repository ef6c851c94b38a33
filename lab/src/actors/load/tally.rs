//! Results of the segments, counted by the actors.

use std::time::Duration;

use parking_lot::{Mutex, MutexGuard};
use proto::Trajectory;
use serde::{Deserialize, Serialize};

use super::histogram::Histogram;
use crate::actors::fingerprint::fingerprint;
use crate::actors::weights::Moment;

/// Results of segments. Each segment that was started is in exactly one of `acked_total`, `stale_total`,
/// `invalid_total`, `failed_total`, `in_doubt_total`, and `unsent_total`. `full_total`, `no_reply_total`, and
/// `no_learner_total` count attempts.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct LoadCounts {
    /// Segments that the learner acknowledged.
    pub(crate) acked_total: u64,
    /// Steps of the acknowledged segments.
    pub(crate) acked_steps_total: u64,
    /// Encoded bytes of the acknowledged segments.
    pub(crate) acked_bytes_total: u64,
    /// Wrapping sum of [`fingerprint`] over the acknowledged segments.
    pub(crate) acked_fingerprints: u64,
    /// Segments that the learner refused as stale.
    pub(crate) stale_total: u64,
    /// Segments that the learner refused as invalid, or because the name is taken.
    pub(crate) invalid_total: u64,
    /// Segments that the session failed to send.
    pub(crate) failed_total: u64,
    /// Segments that the learner may have, because an attempt got no answer.
    pub(crate) in_doubt_total: u64,
    /// Segments that still waited for another attempt at the end; the learner does not have them.
    pub(crate) unsent_total: u64,
    /// Attempts that found the learner's mailbox or queue full.
    pub(crate) full_total: u64,
    /// Attempts without an answer in time.
    pub(crate) no_reply_total: u64,
    /// Attempts while no learner was present.
    pub(crate) no_learner_total: u64,
    /// Time from when a segment was due, or at full speed from its first attempt, to its acknowledgment.
    pub(crate) ack_latency: Histogram,
    /// The first failure of the session.
    pub(crate) first_error: Option<String>,
}

/// Results of the actors of one process, or of several.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct LoadReport {
    /// Actors that took part.
    pub(crate) n_actors: usize,
    /// Longest time from start to stop, in seconds.
    pub(crate) elapsed_s: f64,
    /// Counts of all actors together.
    pub(crate) counts: LoadCounts,
    /// The weights of each actor, oldest first, beginning with those that it held at the start.
    pub(crate) pulls: Vec<Vec<Moment>>,
    /// Pulls of weights that failed and were retried.
    pub(crate) pulls_failed_total: u64,
    /// Weights that could not be decoded.
    pub(crate) weights_invalid_total: u64,
}

impl LoadCounts {
    /// Adds the counts of another process or actor.
    pub(super) fn add(&mut self, other: &Self) {
        self.acked_total += other.acked_total;
        self.acked_steps_total += other.acked_steps_total;
        self.acked_bytes_total += other.acked_bytes_total;
        self.acked_fingerprints = self.acked_fingerprints.wrapping_add(other.acked_fingerprints);
        self.stale_total += other.stale_total;
        self.invalid_total += other.invalid_total;
        self.failed_total += other.failed_total;
        self.in_doubt_total += other.in_doubt_total;
        self.unsent_total += other.unsent_total;
        self.full_total += other.full_total;
        self.no_reply_total += other.no_reply_total;
        self.no_learner_total += other.no_learner_total;
        self.ack_latency.merge(&other.ack_latency);
        self.first_error = self.first_error.take().or_else(|| other.first_error.clone());
    }
}

impl LoadReport {
    /// Adds the results of another process.
    pub(crate) fn add(&mut self, other: Self) {
        self.n_actors += other.n_actors;
        self.elapsed_s = self.elapsed_s.max(other.elapsed_s);
        self.counts.add(&other.counts);
        self.pulls.extend(other.pulls);
        self.pulls_failed_total += other.pulls_failed_total;
        self.weights_invalid_total += other.weights_invalid_total;
    }
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
        counts.acked_fingerprints = counts.acked_fingerprints.wrapping_add(fingerprint(segment));
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

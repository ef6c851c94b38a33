//! Counts of all that the bus dropped or refused.

use std::sync::atomic::{AtomicU64, Ordering};

use serde::{Deserialize, Serialize};

/// A number that only grows, shared by callbacks and tasks.
#[derive(Debug, Default)]
pub(super) struct Counter(AtomicU64);

impl Counter {
    pub(super) fn add_one(&self) {
        // Nothing else is ordered by a count.
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// What a session dropped so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct BusCounts {
    /// Notices of weights that could not be read.
    pub notices_invalid_total: u64,
    /// Weights that could not be read or broke a rule.
    pub weights_invalid_total: u64,
    /// Weights that could be read but not acted by, because they give no distribution over actions or do not fit the network.
    #[serde(default)]
    pub weights_refused_total: u64,
    /// Pulls of weights that failed and were tried again.
    pub pulls_failed_total: u64,
    /// Queries for weights or metrics that carried a payload.
    pub queries_invalid_total: u64,
    /// Queries for weights or metrics that found too many others waiting.
    pub queries_dropped_total: u64,
    /// Metrics that were not JSON.
    pub metrics_invalid_total: u64,
    /// Metrics that a slow reader left no room for.
    pub metrics_dropped_total: u64,
    /// Trajectories that a viewer could not read.
    pub viewed_invalid_total: u64,
    /// Trajectories that a viewer was too slow for.
    pub viewed_dropped_total: u64,
    /// Copies for viewers that could not be put.
    pub views_failed_total: u64,
    /// Liveliness keys without a valid name, or of more names than are followed.
    pub tokens_invalid_total: u64,
}

#[derive(Debug, Default)]
pub(super) struct BusCounters {
    pub(super) notices_invalid: Counter,
    pub(super) weights_invalid: Counter,
    pub(super) weights_refused: Counter,
    pub(super) pulls_failed: Counter,
    pub(super) queries_invalid: Counter,
    pub(super) queries_dropped: Counter,
    pub(super) metrics_invalid: Counter,
    pub(super) metrics_dropped: Counter,
    pub(super) viewed_invalid: Counter,
    pub(super) viewed_dropped: Counter,
    pub(super) views_failed: Counter,
    pub(super) tokens_invalid: Counter,
}

impl BusCounters {
    pub(super) fn counts(&self) -> BusCounts {
        BusCounts {
            notices_invalid_total: self.notices_invalid.get(),
            weights_invalid_total: self.weights_invalid.get(),
            weights_refused_total: self.weights_refused.get(),
            pulls_failed_total: self.pulls_failed.get(),
            queries_invalid_total: self.queries_invalid.get(),
            queries_dropped_total: self.queries_dropped.get(),
            metrics_invalid_total: self.metrics_invalid.get(),
            metrics_dropped_total: self.metrics_dropped.get(),
            viewed_invalid_total: self.viewed_invalid.get(),
            viewed_dropped_total: self.viewed_dropped.get(),
            views_failed_total: self.views_failed.get(),
            tokens_invalid_total: self.tokens_invalid.get(),
        }
    }
}

/// What became of the trajectories that reached a learner: every one is counted in `received_total` and in exactly
/// one of the others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct IngestCounts {
    /// All that arrived, of whatever quality.
    pub received_total: u64,
    /// Taken by the handler.
    pub accepted_total: u64,
    /// Retries of one that was taken before; acknowledged again, not handled again.
    pub duplicates_total: u64,
    /// Refused because of old weights.
    pub stale_total: u64,
    /// Refused because the mailbox, or the queue before it, was full.
    pub full_total: u64,
    /// Refused because a rule was broken.
    pub invalid_total: u64,
    /// Refused because another live actor has the sender's name.
    #[serde(default)]
    pub name_taken_total: u64,
}

#[derive(Debug, Default)]
pub(super) struct IngestCounters {
    pub(super) received: Counter,
    pub(super) accepted: Counter,
    pub(super) duplicates: Counter,
    pub(super) stale: Counter,
    pub(super) full: Counter,
    pub(super) invalid: Counter,
    pub(super) name_taken: Counter,
}

impl IngestCounters {
    pub(super) fn counts(&self) -> IngestCounts {
        IngestCounts {
            received_total: self.received.get(),
            accepted_total: self.accepted.get(),
            duplicates_total: self.duplicates.get(),
            stale_total: self.stale.get(),
            full_total: self.full.get(),
            invalid_total: self.invalid.get(),
            name_taken_total: self.name_taken.get(),
        }
    }
}

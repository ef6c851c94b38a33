//! Counters of everything that the bus dropped or refused.

use std::sync::atomic::{AtomicU64, Ordering};

use proto::metrics::{BusCounts, IngestCounts};

/// A monotonic counter shared by callbacks and tasks.
#[derive(Debug, Default)]
pub(super) struct Counter(AtomicU64);

impl Counter {
    pub(super) fn add_one(&self) {
        self.number_one();
    }

    /// Adds one and returns the count before.
    pub(super) fn number_one(&self) -> u64 {
        // Relaxed: the count orders no other memory accesses.
        self.0.fetch_add(1, Ordering::Relaxed)
    }

    pub(super) fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
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
    /// Names given to senders of queries; not reported.
    pub(super) askers: Counter,
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

//! Results of a measurement.

use std::ops::Sub;

use serde::Serialize;

use super::load::{LoadCounts, LoadReport};
use super::record::Recording;
use super::sink::SinkReport;
use super::usage::{MemoryCurve, MemorySummary, machine_load};
use super::weights::{Delivery, deliveries};
use crate::cli::ActorsArgs;

/// One value for each kind of process.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(super) struct Roles<T> {
    /// All routers together.
    pub(super) router: T,
    pub(super) ingest: T,
    /// All simulated actors together.
    pub(super) actors: T,
}

impl Sub for Roles<f64> {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        let Self { router, ingest, actors } = self;
        Self { router: router - other.router, ingest: ingest - other.ingest, actors: actors - other.actors }
    }
}

/// What `lab actors` prints.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    pub(super) n_actors_asked: u32,
    pub(super) n_actors: usize,
    pub(super) n_processes_of_actors: Option<u32>,
    pub(super) n_leaves: u32,
    /// Steps per second of each actor; 0 is full speed.
    pub(super) rate: f64,
    pub(super) elapsed_s: f64,
    /// The machine's 1-minute load average at the end, other programs included.
    pub(super) machine_load: Option<f64>,
    pub(super) n_segments: u64,
    pub(super) n_steps: u64,
    pub(super) segments_per_s: f64,
    pub(super) steps_per_s: f64,
    /// Mean encoded size of the recorded segments per step, in bytes.
    pub(super) payload_bytes_per_step: f64,
    /// Bytes on the loopback interface, including weights and all other traffic; a segment counts once for each process
    /// that receives it.
    pub(super) loopback_bytes: Option<u64>,
    pub(super) cpu_s: Roles<f64>,
    pub(super) cpu_s_per_million_steps: Roles<f64>,
    pub(super) memory: Roles<Option<MemorySummary>>,
    pub(super) ack_latency_ms: Quantiles,
    pub(super) weights: WeightsReport,
    pub(super) counts: LoadCounts,
    pub(super) ingest: SinkReport,
    pub(super) reconciled: Reconciled,
}

/// Median, 99th percentile, and maximum of a set of times.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Quantiles {
    pub(super) p50: f64,
    pub(super) p99: f64,
    pub(super) max: f64,
}

/// How weights reached the actors.
#[derive(Debug, Serialize)]
pub(super) struct WeightsReport {
    pub(super) parameter_bytes: u64,
    pub(super) every_s: f64,
    pub(super) pulls_failed_total: u64,
    pub(super) weights_invalid_total: u64,
    pub(super) deliveries: Vec<Delivery>,
}

/// The counts of both ends, side by side.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Reconciled {
    /// Segments that were acknowledged to their actor.
    pub(super) acked: u64,
    /// Segments that the ingest accepted.
    pub(super) accepted: u64,
    /// Segments without an acknowledgment that the ingest may have accepted nevertheless.
    pub(super) in_doubt: u64,
    /// Acknowledged segments that the ingest did not accept.
    pub(super) lost: u64,
    /// Accepted segments that no update consumed, that did not expire, and that are not waiting.
    pub(super) vanished: u64,
    /// Whether the fingerprints of both ends match; `None` if segments are in doubt.
    pub(super) same_segments: Option<bool>,
    /// Whether the counts above are consistent.
    pub(super) agrees: bool,
}

impl Reconciled {
    pub(super) fn new(counts: &LoadCounts, ingest: &SinkReport) -> Self {
        let (acked, accepted, in_doubt) = (counts.acked_total, ingest.ingest.accepted_total, counts.in_doubt_total);
        let lost = acked.saturating_sub(accepted);
        let kept = ingest.taken_total + ingest.waiting_total + ingest.mailbox.expired_total;
        let vanished = accepted.abs_diff(kept).max(accepted.abs_diff(ingest.mailbox.accepted_total));
        let same_segments = (in_doubt == 0).then_some(counts.acked_fingerprints == ingest.accepted_fingerprints);
        let agrees = lost == 0 && vanished == 0 && accepted <= acked + in_doubt && same_segments.unwrap_or(true);
        Self { acked, accepted, in_doubt, lost, vanished, same_segments, agrees }
    }
}

/// Resource usage of a measurement.
pub(super) struct Used {
    pub(super) cpu_s: Roles<f64>,
    pub(super) memory: Roles<MemoryCurve>,
    pub(super) loopback_bytes: Option<u64>,
}

impl Report {
    pub(super) fn new(
        args: &ActorsArgs,
        recording: &Recording,
        sent: &LoadReport,
        sank: &SinkReport,
        used: &Used,
    ) -> Self {
        let counts = &sent.counts;
        let per_million = |cpu_s: f64| cpu_s * 1e6 / (counts.acked_steps_total as f64).max(1.0);
        let Roles { router, ingest, actors } = used.cpu_s;
        let ms = |share| counts.ack_latency.quantile(share).unwrap_or_default().as_secs_f64() * 1e3;
        let own_bytes = recording.n_parameters as u64 * size_of::<f32>() as u64;
        Self {
            n_actors_asked: args.actors,
            n_actors: sent.n_actors,
            n_processes_of_actors: args.processes,
            n_leaves: args.leaves,
            rate: args.rate,
            elapsed_s: sent.elapsed_s,
            machine_load: machine_load(),
            n_segments: counts.acked_total,
            n_steps: counts.acked_steps_total,
            segments_per_s: counts.acked_total as f64 / sent.elapsed_s,
            steps_per_s: counts.acked_steps_total as f64 / sent.elapsed_s,
            payload_bytes_per_step: recording.n_bytes as f64 / recording.n_steps as f64,
            loopback_bytes: used.loopback_bytes,
            cpu_s: used.cpu_s,
            cpu_s_per_million_steps: Roles {
                router: per_million(router),
                ingest: per_million(ingest),
                actors: per_million(actors),
            },
            memory: Roles {
                router: used.memory.router.summary(),
                ingest: used.memory.ingest.summary(),
                actors: used.memory.actors.summary(),
            },
            ack_latency_ms: Quantiles {
                p50: ms(0.5),
                p99: ms(0.99),
                max: counts.ack_latency.max().as_secs_f64() * 1e3,
            },
            weights: WeightsReport {
                parameter_bytes: args.weights_bytes.unwrap_or(own_bytes),
                every_s: args.weights_every,
                pulls_failed_total: sent.pulls_failed_total,
                weights_invalid_total: sent.weights_invalid_total,
                deliveries: deliveries(&sank.published, &sent.pulls),
            },
            reconciled: Reconciled::new(counts, sank),
            counts: counts.clone(),
            ingest: SinkReport { published: Vec::new(), ..sank.clone() },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn agrees(acked: u64, in_doubt: u64, accepted: u64, taken: u64, fingerprints: [u64; 2]) -> Reconciled {
        let counts = LoadCounts {
            acked_total: acked,
            in_doubt_total: in_doubt,
            acked_fingerprints: fingerprints[0],
            ..LoadCounts::default()
        };
        let mut sank =
            SinkReport { taken_total: taken, accepted_fingerprints: fingerprints[1], ..SinkReport::default() };
        sank.ingest.accepted_total = accepted;
        sank.mailbox.accepted_total = accepted;
        Reconciled::new(&counts, &sank)
    }

    #[test]
    fn counts_that_contradict_each_other_are_found() {
        assert!(agrees(10, 0, 10, 10, [7, 7]).agrees);
        assert!(agrees(10, 2, 11, 11, [7, 9]).agrees);
        assert_eq!(agrees(10, 0, 9, 9, [7, 7]).lost, 1);
        assert_eq!(agrees(10, 0, 10, 8, [7, 7]).vanished, 2);
        // As many segments, but different ones.
        assert!(!agrees(10, 0, 10, 10, [7, 8]).agrees);
        // Accepted, but never sent.
        assert!(!agrees(10, 0, 11, 11, [7, 7]).agrees);
    }
}

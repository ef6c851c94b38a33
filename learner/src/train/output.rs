//! Where weights and metrics go: the bus, this process, and the run folder.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use blueprints::outside::as_text;
use bus::{Bus, TrajectoryServer, unix_ms};
use proto::metrics::LearnerMetrics;
use proto::{Weights, WeightsVersion};
use runlog::{Lines, MetricsWriter, RunPaths};
use serde::Serialize;
use tokio::sync::{mpsc, watch};
use tokio_util::sync::CancellationToken;

use crate::learner::Learner;
use crate::mailbox::MailboxCounts;

/// Time between attempts of a run to save what it could not. Training waits so long.
pub const SAVE_RETRY: Duration = Duration::from_secs(30);

/// The result of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Version of the newest weights.
    pub weights_version: WeightsVersion,
    /// Updates, including those before a resume.
    pub n_updates: u64,
    /// Environment steps, including those before a resume.
    pub n_env_steps: u64,
    /// Elapsed seconds, including those before a resume.
    pub run_elapsed_s: f64,
    /// Number of trajectories by result.
    pub mailbox: MailboxCounts,
    /// The last checkpoint.
    #[serde(serialize_with = "as_text")]
    pub checkpoint: PathBuf,
    /// The newest weights themselves, for an evaluator in this process.
    #[serde(skip)]
    pub weights: Arc<Weights>,
}

/// A message from the updating thread to the bus.
pub(crate) struct Publication {
    pub(crate) weights: Arc<Weights>,
    /// `None` for the initial weights of the run.
    pub(crate) metrics: Option<LearnerMetrics>,
}

/// What the updating thread writes to.
pub(crate) struct Output {
    pub(crate) run_dir: RunPaths,
    pub(crate) records: MetricsWriter,
    pub(crate) saving: Saving,
    pub(crate) save_retry: Duration,
    /// Steps of the run.
    pub(crate) max_env_steps: Option<u64>,
    pub(crate) publications: mpsc::Sender<Publication>,
    /// Gets the metrics of every update too.
    pub(crate) metrics_sender: watch::Sender<Option<LearnerMetrics>>,
    pub(crate) server: TrajectoryServer,
    pub(crate) bus: Bus,
    pub(crate) shutdown: CancellationToken,
    pub(crate) start: Instant,
    /// Seconds that the run took before this process.
    pub(crate) before_s: f64,
    pub(crate) update_start: Instant,
    pub(crate) last_update: Instant,
    /// The learner's newest weights.
    pub(crate) newest: Arc<Weights>,
}

/// What is on disk, and what is not yet.
#[derive(Debug)]
pub(crate) struct Saving {
    /// Time of the last checkpoint of this process, or of its start, in milliseconds since 1970.
    pub(super) saved_unix_ms: u64,
    /// The last checkpoint of this process.
    pub(super) checkpoint: Option<PathBuf>,
    /// The line of the newest update, until it is written.
    pub(super) line: Option<Lines>,
    /// The points of the newest update, until they are written.
    pub(super) scalars: Option<(u64, Vec<(String, f64)>)>,
    pub(super) is_due: bool,
    /// The newest update's metrics.
    pub(super) metrics: Option<LearnerMetrics>,
}

impl Default for Saving {
    fn default() -> Self {
        let saved_unix_ms = unix_ms();
        Self { saved_unix_ms, checkpoint: None, line: None, scalars: None, is_due: false, metrics: None }
    }
}

impl Output {
    /// Returns how many steps the next update takes; `None` if the run ends.
    pub(super) fn next_steps(&self, learner: &Learner) -> Option<usize> {
        self.bus.pulse().beat();
        let n_left = self.max_env_steps.map(|max| max.saturating_sub(learner.n_env_steps()));
        // A closed channel means that the session failed; the run then ends with a checkpoint as usual.
        let is_over = n_left == Some(0) || self.is_stopped();
        (!is_over).then(|| next_steps(learner.setup.config.batch_size, n_left))
    }

    pub(super) fn is_stopped(&self) -> bool {
        self.shutdown.is_cancelled() || self.publications.is_closed()
    }

    /// Starts to measure an update.
    pub(super) fn start_update(&mut self) {
        self.update_start = Instant::now();
    }

    /// Publishes the weights and metrics of an update.
    pub(super) fn publish(&mut self, learner: &Learner, update: &LearnerMetrics) {
        self.newest = Arc::new(learner.weights());
        let metrics = self.metrics(update);
        self.last_update = Instant::now();
        self.send(Some(metrics.clone()));
        self.saving.metrics = Some(metrics);
    }

    /// Shows the metrics in this process, and hands them and the newest weights to the bus, unless the session failed.
    /// There are no metrics of the weights that a run begins with.
    pub(super) fn send(&self, metrics: Option<LearnerMetrics>) {
        if let Some(metrics) = &metrics {
            self.metrics_sender.send_replace(Some(metrics.clone()));
        }
        let publication = Publication { weights: self.newest.clone(), metrics };
        if self.publications.blocking_send(publication).is_err() {
            tracing::debug!("the weights were not published, because the session failed");
        }
    }

    /// Returns the result of the run so far.
    pub(super) fn summary(&self, learner: &Learner, checkpoint: PathBuf) -> Summary {
        Summary {
            weights_version: learner.version(),
            n_updates: learner.n_updates(),
            n_env_steps: learner.n_env_steps(),
            run_elapsed_s: self.run_elapsed_s(),
            mailbox: learner.mailbox().counts(),
            checkpoint,
            weights: self.newest.clone(),
        }
    }

    fn run_elapsed_s(&self) -> f64 {
        self.before_s + self.start.elapsed().as_secs_f64()
    }

    /// Returns the metrics of an update with times and the counts of the bus.
    fn metrics(&self, update: &LearnerMetrics) -> LearnerMetrics {
        LearnerMetrics {
            elapsed_s: self.start.elapsed().as_secs_f64(),
            run_elapsed_s: self.run_elapsed_s(),
            env_steps_per_s: update.n_update_steps as f64 / self.last_update.elapsed().as_secs_f64().max(1e-9),
            update_s: self.update_start.elapsed().as_secs_f64(),
            ingest: self.server.counts(),
            bus: self.bus.counts(),
            ..update.clone()
        }
    }
}

/// Returns how many steps the next update takes if `n_left` are left of the run: `per_update`, but the last two updates
/// share what is left. So a run ends with the step that was asked for, give or take the rest of a segment, and not with
/// an update of a handful of steps.
fn next_steps(per_update: usize, n_left: Option<u64>) -> usize {
    match n_left.and_then(|n| usize::try_from(n).ok()) {
        Some(n) if n <= per_update => n.max(1),
        Some(n) if n < 2 * per_update => n.div_ceil(2),
        _ => per_update,
    }
}

#[cfg(test)]
mod tests {
    use super::next_steps;

    #[test]
    fn the_last_two_updates_share_what_is_left() {
        assert_eq!(next_steps(2048, None), 2048);
        for (n_left, expected) in [(10_000, 2048), (4096, 2048), (4095, 2048), (2500, 1250), (2048, 2048), (1250, 1250)]
        {
            assert_eq!(next_steps(2048, Some(n_left)), expected, "{n_left}");
        }
        assert_eq!((next_steps(2048, Some(1)), next_steps(1, Some(1))), (1, 1));
    }
}

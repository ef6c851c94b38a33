//! Metrics of one update; [`crate::train`] adds timings and bus counts.

use proto::metrics::{EpisodeMetrics, LearnerMetrics, METRICS_SCHEMA_VERSION, PpoMetrics};

use crate::batch::Batch;
use crate::learner::Learner;
use crate::ppo::Learned;

/// The result of one update.
#[derive(Clone, Debug, PartialEq)]
pub struct UpdateResult {
    /// Metrics of the update; times and the counts of the bus are 0.
    pub metrics: LearnerMetrics,
    /// Why the update was taken back; `None` if its weights are in force.
    pub refused: Option<String>,
}

impl Learner {
    /// Describes the newest update, on a batch from trajectories of `n_steps` environment steps.
    pub(crate) fn result(
        &self,
        batch: &Batch,
        n_steps: u64,
        learned: Learned,
        episodes: EpisodeMetrics,
        refused: Option<String>,
    ) -> UpdateResult {
        let histogram = batch.lag_histogram();
        let total: u64 = histogram.iter().zip(0..).map(|(n, lag): (_, u64)| n * lag).sum();
        let metrics = LearnerMetrics {
            schema_version: METRICS_SCHEMA_VERSION,
            weights_version: self.state.version,
            n_updates: self.state.n_updates,
            n_env_steps: self.state.n_env_steps,
            n_update_steps: n_steps,
            n_episodes: self.state.n_episodes,
            policy_lag_mean: total as f64 / batch.n_samples().max(1) as f64,
            policy_lag_max: histogram.len() as u64 - 1,
            policy_lag_histogram: histogram,
            n_mailbox: self.mailbox.n_steps() as u64,
            expired_total: self.mailbox.counts().expired_total,
            unmade_total: self.n_unmade,
            refused_total: self.n_refused,
            ppo: if refused.is_some() { kept(&learned.ppo) } else { learned.ppo },
            proposals: learned.proposals,
            episodes,
            task_probabilities: self.state.curriculum.probabilities(),
            ..LearnerMetrics::default()
        };
        UpdateResult { metrics, refused }
    }
}

/// Returns what remains true of an update that was taken back. Its losses mean nothing, and may not even be numbers.
fn kept(ppo: &PpoMetrics) -> PpoMetrics {
    PpoMetrics {
        learning_rate: ppo.learning_rate,
        n_samples: ppo.n_samples,
        n_gradient_steps: ppo.n_gradient_steps,
        n_skipped_steps: ppo.n_skipped_steps,
        n_epochs: ppo.n_epochs,
        ..PpoMetrics::default()
    }
}

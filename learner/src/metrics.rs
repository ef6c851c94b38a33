//! Metrics of one update; [`crate::train`] adds timings and bus counts.

use std::collections::BTreeMap;

use blueprints::BlueprintId;
use proto::WeightsVersion;
use proto::metrics::{EpisodeMetrics, PpoMetrics, ProposalMetrics};
use serde::Serialize;

use crate::batch::Batch;
use crate::learner::Learner;
use crate::mailbox::MailboxCounts;
use crate::ppo::Learned;

/// Metrics of one update.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct UpdateMetrics {
    /// Weights version after the update.
    pub weights_version: WeightsVersion,
    /// Updates so far.
    pub n_updates: u64,
    /// Environment steps so far.
    pub n_env_steps: u64,
    /// Episodes that ended so far.
    pub n_episodes: u64,
    /// Mean policy lag of the batch's samples, versions.
    pub policy_lag_mean: f64,
    /// Largest policy lag in the batch, versions.
    pub policy_lag_max: u64,
    /// Samples of the batch by policy lag.
    pub policy_lag_histogram: Vec<u64>,
    /// Environment steps waiting in the mailbox.
    pub n_mailbox: u64,
    /// Trajectories so far, by result.
    pub mailbox: MailboxCounts,
    /// Accepted trajectories that could not be learned from since the start of the process, by
    /// [`proto::metrics::LearnerMetrics::unmade_total`].
    pub unmade_total: u64,
    /// Updates that were taken back since the start of the process.
    pub refused_total: u64,
    /// Why this update was taken back; `None` if its weights are in force.
    pub refused: Option<String>,
    /// Environment steps of this update.
    pub n_steps: u64,
    /// PPO metrics.
    pub ppo: PpoMetrics,
    /// What the mixture head drew; `None` for the Gaussian head, and if PPO had no samples.
    pub proposals: Option<ProposalMetrics>,
    /// Episodes that ended in the batch.
    pub episodes: EpisodeMetrics,
    /// Probability of each training blueprint.
    pub task_probabilities: BTreeMap<BlueprintId, f32>,
}

/// An update that [`UpdateMetrics`] describe.
pub(crate) struct Update<'a> {
    pub(crate) batch: &'a Batch,
    /// Environment steps of its trajectories.
    pub(crate) n_steps: u64,
    pub(crate) learned: Learned,
    pub(crate) episodes: EpisodeMetrics,
    /// Why it was taken back.
    pub(crate) refused: Option<String>,
}

impl Learner {
    /// Returns the metrics of the newest update.
    pub(crate) fn metrics(&self, update: Update<'_>) -> UpdateMetrics {
        let Update { batch, n_steps, learned, episodes, refused } = update;
        let histogram = batch.lag_histogram();
        let total: u64 = histogram.iter().zip(0..).map(|(n, lag): (_, u64)| n * lag).sum();
        UpdateMetrics {
            weights_version: self.state.version,
            n_updates: self.state.n_updates,
            n_env_steps: self.state.n_env_steps,
            n_episodes: self.state.n_episodes,
            policy_lag_mean: total as f64 / batch.n_samples().max(1) as f64,
            policy_lag_max: histogram.len() as u64 - 1,
            policy_lag_histogram: histogram,
            n_mailbox: self.mailbox.n_steps() as u64,
            mailbox: self.mailbox.counts(),
            unmade_total: self.n_unmade,
            refused_total: self.n_refused,
            ppo: if refused.is_some() { kept(&learned.ppo) } else { learned.ppo },
            refused,
            n_steps,
            proposals: learned.proposals,
            episodes,
            task_probabilities: self.state.curriculum.probabilities(),
        }
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

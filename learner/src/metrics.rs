//! Metrics of one update; [`mod@crate::run`] adds timings and bus counts.

use std::collections::BTreeMap;

use blueprints::BlueprintId;
use proto::WeightsVersion;
use proto::metrics::{EpisodeMetrics, PpoMetrics, ProposalMetrics};
use serde::Serialize;

use crate::batch::Batch;
use crate::mailbox::{Mailbox, MailboxCounts};
use crate::ppo::Learned;
use crate::state::LearnerState;

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
    /// Environment steps of this update: the samples, and the burn-ins before them.
    pub n_steps: u64,
    /// PPO metrics.
    pub ppo: PpoMetrics,
    /// What the mixture head drew; `None` for the Gaussian head, and if PPO had no samples.
    pub proposals: Option<ProposalMetrics>,
    /// Episodes that ended in the batch.
    pub episodes: EpisodeMetrics,
    /// Probability of each training blueprint.
    pub task_probabilities: BTreeMap<BlueprintId, f32>,
    /// Maximum number of blocks removed at the start of an episode, by the goal's number of blocks.
    pub reverse_reach: BTreeMap<u8, u8>,
}

impl UpdateMetrics {
    pub(crate) fn new(
        state: &LearnerState,
        batch: &Batch,
        n_steps: u64,
        Learned { ppo, proposals }: Learned,
        episodes: EpisodeMetrics,
        mailbox: &Mailbox,
    ) -> Self {
        let histogram = batch.lag_histogram();
        let total: u64 = histogram.iter().zip(0..).map(|(n, lag): (_, u64)| n * lag).sum();
        Self {
            weights_version: state.version,
            n_updates: state.n_updates,
            n_env_steps: state.n_env_steps,
            n_episodes: state.n_episodes,
            policy_lag_mean: total as f64 / batch.n_samples().max(1) as f64,
            policy_lag_max: histogram.len() as u64 - 1,
            policy_lag_histogram: histogram,
            n_mailbox: mailbox.n_steps() as u64,
            mailbox: mailbox.counts(),
            unmade_total: 0,
            refused_total: 0,
            refused: None,
            n_steps,
            ppo,
            proposals,
            episodes,
            task_probabilities: state.curriculum.probabilities(),
            reverse_reach: state.reverse.reach(),
        }
    }
}

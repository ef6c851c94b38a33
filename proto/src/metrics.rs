//! What services report about themselves, as JSON on `metrics/…` and as lines of `metrics.jsonl`.
//!
//! Fields are only ever added within a schema version, and a reader ignores those that it does not know.

use std::collections::BTreeMap;

use blueprints::{BlueprintId, Split};
use serde::{Deserialize, Serialize};

use crate::bus::{BusCounts, IngestCounts};
use crate::wilson::SuccessRate;
use crate::{ActorId, RewardTerms, WeightsVersion};

/// Version of all structs here.
pub const METRICS_SCHEMA_VERSION: u32 = 1;

/// The learner's state after an update; key `metrics/learner`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LearnerMetrics {
    /// [`METRICS_SCHEMA_VERSION`].
    pub schema_version: u32,
    /// Weights after the update.
    pub weights_version: WeightsVersion,
    /// PPO updates so far.
    pub n_updates: u64,
    /// Environment steps consumed so far.
    pub n_env_steps: u64,
    /// Episodes whose end was seen so far.
    pub n_episodes: u64,
    /// Time since the learner's start, seconds.
    pub elapsed_s: f64,
    /// Environment steps consumed per second since the last report.
    pub env_steps_per_s: f64,
    /// Duration of the update, seconds.
    pub update_s: f64,
    /// Mean of (current version − acting version) over the batch, versions.
    pub policy_lag_mean: f64,
    /// Largest such lag in the batch, versions.
    pub policy_lag_max: u64,
    /// Trajectories waiting in the mailbox.
    pub n_mailbox: u64,
    /// Numbers of the PPO update.
    pub ppo: PpoMetrics,
    /// Of the episodes that ended since the last report.
    pub episodes: EpisodeMetrics,
    /// What became of the trajectories that arrived.
    pub ingest: IngestCounts,
    /// What the bus dropped.
    pub bus: BusCounts,
    /// Probability of each training blueprint.
    pub task_probabilities: BTreeMap<BlueprintId, f32>,
}

/// Means over the minibatches of one PPO update, by their usual names.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PpoMetrics {
    /// Weighted sum of the losses that was minimised.
    pub total_loss: f64,
    /// Clipped surrogate loss.
    pub policy_loss: f64,
    /// Value loss, on normalised values.
    pub value_loss: f64,
    /// Entropy of the action distribution, nats.
    pub entropy: f64,
    /// Estimate of KL(behavior ‖ current), nats.
    pub approx_kl: f64,
    /// Fraction of samples whose ratio was clipped, 0 to 1.
    pub clip_fraction: f64,
    /// 1 − Var(target − value) / Var(target) before the update; at most 1, 0 for a constant guess.
    pub explained_variance: f64,
    /// Norm of the gradient before clipping.
    pub grad_norm: f64,
    /// Learning rate used.
    pub learning_rate: f64,
    /// Samples in the batch.
    pub n_samples: u64,
    /// Gradient steps taken.
    pub n_gradient_steps: u64,
    /// Mean of the value targets, reward units.
    pub value_mean: f64,
    /// Standard deviation of the value targets, reward units.
    pub value_std: f64,
}

/// Of finished episodes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EpisodeMetrics {
    /// All episodes together.
    pub success: SuccessRate,
    /// Mean steps per episode, 0 without episodes.
    pub mean_steps: f64,
    /// Mean undiscounted return by term, 0 without episodes.
    pub mean_return: RewardTerms,
    /// By blueprint; those without episodes are absent.
    pub success_by_blueprint: BTreeMap<BlueprintId, SuccessRate>,
}

/// An actor's state; key `metrics/actor/<id>`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ActorMetrics {
    /// [`METRICS_SCHEMA_VERSION`].
    pub schema_version: u32,
    /// Who.
    pub actor: ActorId,
    /// Start time of the process, ms since 1970.
    pub epoch: u64,
    /// Weights that act.
    pub weights_version: WeightsVersion,
    /// Time since the actor's start, seconds.
    pub elapsed_s: f64,
    /// Worlds stepped in parallel.
    pub n_worlds: u64,
    /// Environment steps made so far.
    pub n_env_steps: u64,
    /// Environment steps per second since the last report.
    pub env_steps_per_s: f64,
    /// Episodes ended so far.
    pub n_episodes: u64,
    /// Learner's version in the last answer − acting version, versions.
    pub policy_lag: u64,
    /// Trajectories that the learner took so far.
    pub n_trajectories_acked: u64,
    /// Trajectories dropped so far, by reason.
    pub dropped: ActorDrops,
    /// Whether a learner is there.
    pub learner_is_there: bool,
    /// What the bus dropped.
    pub bus: BusCounts,
}

/// Trajectories that an actor dropped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ActorDrops {
    /// The learner called them stale.
    pub stale_total: u64,
    /// The learner's mailbox was full.
    pub full_total: u64,
    /// The learner called them invalid.
    pub invalid_total: u64,
    /// The learner was away and newer ones took their place, or the actor ended.
    pub no_learner_total: u64,
    /// No answer, after the last attempt.
    pub no_reply_total: u64,
    /// Larger than allowed.
    pub too_large_total: u64,
    /// Their episode diverged.
    pub diverged_total: u64,
    /// The session failed.
    pub failed_total: u64,
}

/// One frozen policy on one blueprint; key `metrics/eval/<split>/<blueprint>`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvalBlueprint {
    /// [`METRICS_SCHEMA_VERSION`].
    pub schema_version: u32,
    /// Weights that were judged.
    pub weights_version: WeightsVersion,
    /// Environment steps that the learner had consumed for them.
    pub n_env_steps: u64,
    /// The goal.
    pub blueprint: BlueprintId,
    /// Its part of the catalogue.
    pub split: Split,
    /// Its number of blocks.
    pub n_blocks: u64,
    /// With actions sampled from the policy.
    pub sampled: EvalOutcome,
    /// With the most probable action.
    pub mode: EvalOutcome,
}

/// Episodes of one kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EvalOutcome {
    /// Success rate and interval; diverged episodes count as failures.
    pub success: SuccessRate,
    /// Mean steps of all episodes, 0 without any.
    pub mean_steps: f64,
    /// Mean undiscounted return by term, 0 without episodes.
    pub mean_return: RewardTerms,
    /// Episodes whose physics diverged.
    pub n_diverged: u64,
}

/// One frozen policy on all blueprints judged; key `metrics/eval/summary`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvalSummary {
    /// [`METRICS_SCHEMA_VERSION`].
    pub schema_version: u32,
    /// Weights that were judged.
    pub weights_version: WeightsVersion,
    /// Environment steps that the learner had consumed for them.
    pub n_env_steps: u64,
    /// Duration of the evaluation, seconds.
    pub elapsed_s: f64,
    /// All blueprints together.
    pub all: EvalGroup,
    /// By split and number of blocks, in this order.
    pub groups: Vec<EvalGroup>,
    /// What the bus dropped.
    pub bus: BusCounts,
}

/// Blueprints of one split and size, or all.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EvalGroup {
    /// Their split; `null` for all.
    pub split: Option<Split>,
    /// Their number of blocks; `null` for all.
    pub n_blocks: Option<u64>,
    /// How many blueprints.
    pub n_blueprints: u64,
    /// With actions sampled from the policy.
    pub sampled: EvalOutcome,
    /// With the most probable action.
    pub mode: EvalOutcome,
}

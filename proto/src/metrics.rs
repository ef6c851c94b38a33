//! What services report about themselves, as JSON on `metrics/…` and as lines of `metrics.jsonl`.
//!
//! Fields are only ever added within a schema version, and a reader ignores those that it does not know.

use std::collections::BTreeMap;

use blueprints::{BlueprintId, Split};
use serde::{Deserialize, Serialize};

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
    /// Environment steps of the batch by lag: entry `i` counts those of lag `i`.
    pub policy_lag_histogram: Vec<u64>,
    /// Environment steps waiting in the mailbox.
    pub n_mailbox: u64,
    /// Trajectories that grew too old while waiting in the mailbox, so far.
    pub expired_total: u64,
    /// Trajectories that were dropped after they had been taken, since the start of the process, because their generated goal
    /// is one of the held-out structures, comes to nothing, or was one too many to be made for an update.
    #[serde(default)]
    pub unmade_total: u64,
    /// Numbers of the PPO update.
    pub ppo: PpoMetrics,
    /// Learning from the expert; `null` without.
    #[serde(default)]
    pub imitation: Option<ImitationMetrics>,
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
    /// Weighted sum of the losses that was minimized.
    pub total_loss: f64,
    /// Clipped surrogate loss.
    pub policy_loss: f64,
    /// Value loss, on normalized values.
    pub value_loss: f64,
    /// Entropy of the action distribution, nats.
    pub entropy: f64,
    /// Its part from the choice of blocks, nats.
    pub entropy_blocks: f64,
    /// Its part from the moves of the chosen blocks (expected over the choice), nats.
    pub entropy_moves: f64,
    /// Estimate of KL(reference ‖ current) over the last epoch, nats; see the learner's objective for the reference.
    pub approx_kl: f64,
    /// Fraction of samples whose ratio was clipped in the last epoch, 0 to 1.
    pub clip_fraction: f64,
    /// (Σw)² / (n Σw²) of the importance weights of the policy before the update against those that acted, 0 to 1;
    /// 1 without policy lag.
    pub effective_sample_size: f64,
    /// 1 − Var(target − value) / Var(target) before the update; at most 1, 0 for a constant guess.
    pub explained_variance: f64,
    /// Mean KL(imitator ‖ policy), nats; 0 while nothing holds the policy to the imitator.
    #[serde(default)]
    pub imitator_kl: f64,
    /// Norm of the gradient before clipping.
    pub grad_norm: f64,
    /// Learning rate used.
    pub learning_rate: f64,
    /// Samples in the batch.
    pub n_samples: u64,
    /// Gradient steps taken.
    pub n_gradient_steps: u64,
    /// Gradient steps left out because the gradient was not finite.
    pub n_skipped_steps: u64,
    /// Epochs made; fewer than configured when the KL divergence grew too large.
    pub n_epochs: u64,
    /// Mean of the value targets, reward units.
    pub value_mean: f64,
    /// Standard deviation of the value targets, reward units.
    pub value_std: f64,
}

/// One update's learning from the expert's labels; means over scenes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ImitationMetrics {
    /// Weight in the loss.
    pub weight: f64,
    /// Σ over grippers of the cross-entropy of the block choice, nats.
    pub block_loss: f64,
    /// Σ over labeled blocks of the mean smooth L1 distance of the move, fractions of the speed limits.
    pub move_loss: f64,
    /// Fraction of the scenes in which the likeliest block is the expert's for all grippers, 0 to 1.
    pub block_accuracy: f64,
    /// Gradient steps with labels.
    pub n_gradient_steps: u64,
    /// Labeled scenes that are kept.
    pub n_replay: u64,
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
    /// The learner took another live process for the owner of the actor's name, and the actor ended.
    #[serde(default)]
    pub name_taken_total: u64,
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
    /// Its part of the catalog.
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
    /// The same for successes that lasted: held for some steps in a row at low speed.
    pub stable_success: SuccessRate,
    /// Mean steps of all episodes, 0 without any.
    pub mean_steps: f64,
    /// Mean steps of the successful episodes; `null` without any.
    pub mean_steps_to_success: Option<f64>,
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
    /// Duration of the evaluation so far, seconds.
    pub elapsed_s: f64,
    /// Whether the pass has ended. Before that, numbers of some of its episodes are reported, spread over all blueprints.
    #[serde(default = "complete")]
    pub is_complete: bool,
    /// Episodes of the whole pass with each way of acting, without the reset-free runs.
    #[serde(default)]
    pub n_planned: u64,
    /// Episodes, or reset-free runs, that other processes ran for the evaluator, in both ways of acting.
    #[serde(default)]
    pub n_assisted: u64,
    /// Seed of the start states; passes with the same seed start from the same states.
    pub seed: u64,
    /// All blueprints together.
    pub all: EvalGroup,
    /// The paper's groups in its order; those of which no blueprint was judged are left out.
    pub groups: Vec<EvalGroup>,
    /// Several goals in a row without a reset; `null` when that was not asked for.
    pub reset_free: Option<EvalResetFree>,
    /// What the bus dropped.
    pub bus: BusCounts,
    /// Films of episodes; `null` when none are asked for.
    #[serde(default)]
    pub films: Option<FilmCounts>,
}

/// What became of the films of an evaluator since its start. Those of a pass are mostly made after its summary.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FilmCounts {
    /// Files written.
    pub written_total: u64,
    /// Episodes that wait to be made into films.
    pub n_waiting: u64,
    /// Episodes left out because too many waited, or the evaluator ended before their turn.
    pub dropped_total: u64,
    /// Episodes that could not be drawn, or files that could not be written or removed.
    pub failed_total: u64,
    /// Episodes that were not recorded, though one like them was wanted, because too many were being recorded.
    pub unrecorded_total: u64,
    /// Small films that TensorBoard was not given because they were too large.
    pub oversized_total: u64,
}

/// What a summary is that does not say: early ones were only made at the end of a pass.
fn complete() -> bool {
    true
}

/// Blueprints that are reported together.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EvalGroup {
    /// `train 2-6`, `train 7-11`, `train 12-16`, `test 12-16`, `test special` or `all`.
    pub name: String,
    /// How many blueprints.
    pub n_blueprints: u64,
    /// With actions sampled from the policy.
    pub sampled: EvalOutcome,
    /// With the most probable action.
    pub mode: EvalOutcome,
}

/// Goals one after the other in worlds that are not reset in between (paper, section "Reset-Free Evaluation").
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EvalResetFree {
    /// Worlds.
    pub n_runs: u64,
    /// Goals in each.
    pub n_goals: u64,
    /// With actions sampled from the policy.
    pub sampled: EvalRuns,
    /// With the most probable action.
    pub mode: EvalRuns,
}

/// Reset-free runs of one kind.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EvalRuns {
    /// All goals of all runs.
    pub outcome: EvalOutcome,
    /// Successes at the first goal of a run, at the second, and so on; empty when these actions were not judged.
    pub n_successes_by_goal: Vec<u64>,
    /// Standard deviation over the runs of a run's success rate.
    pub run_rate_std: f64,
    /// Times that a world diverged and had to be reset after all.
    pub n_forced_resets: u64,
}

/// What one pass over frozen weights found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvalReport {
    /// All blueprints, groups and reset-free runs.
    pub summary: EvalSummary,
    /// Each blueprint, ordered by split, size and id.
    pub blueprints: Vec<EvalBlueprint>,
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

//! Reports of the services, as JSON on `metrics/…` and as lines of `metrics.jsonl`.
//!
//! Fields are only ever added to a schema version, and readers ignore unknown fields.

use std::collections::BTreeMap;

use blueprints::{BlueprintId, Group, Split};
use serde::{Deserialize, Serialize};

use crate::wilson::SuccessRate;
use crate::{ActionMode, ActorId, RewardTerms, WeightsVersion};

/// Schema version of all structs in this module.
pub const METRICS_SCHEMA_VERSION: u32 = 2;

/// The learner's state after an update; key `metrics/learner`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LearnerMetrics {
    /// [`METRICS_SCHEMA_VERSION`].
    pub schema_version: u32,
    /// Weights version after the update.
    pub weights_version: WeightsVersion,
    /// PPO updates so far.
    pub n_updates: u64,
    /// Environment steps consumed so far.
    pub n_env_steps: u64,
    /// Environment steps of this update.
    #[serde(default)]
    pub n_update_steps: u64,
    /// Episodes that ended so far.
    pub n_episodes: u64,
    /// Time since the learner's start, seconds.
    pub elapsed_s: f64,
    /// Time taken by all learner processes of the run, including those before a resume, seconds; 0 if unknown.
    #[serde(default)]
    pub run_elapsed_s: f64,
    /// Environment steps consumed per second since the last report.
    pub env_steps_per_s: f64,
    /// Duration of the update, seconds.
    pub update_s: f64,
    /// Mean of (current version − acting version) over the batch, versions.
    pub policy_lag_mean: f64,
    /// Largest policy lag in the batch, versions.
    pub policy_lag_max: u64,
    /// Samples of the batch by policy lag: entry `i` counts those with lag `i`.
    pub policy_lag_histogram: Vec<u64>,
    /// Environment steps waiting in the mailbox.
    pub n_mailbox: u64,
    /// Trajectories that became too old in the mailbox so far.
    pub expired_total: u64,
    /// Accepted trajectories that were dropped since the start of the process because their draws are not among
    /// what their scenes offer, or the network gives a value or a log-probability that is not finite for them.
    #[serde(default)]
    pub unmade_total: u64,
    /// Updates that were taken back since the start of the process, because no policy could act with their weights.
    #[serde(default)]
    pub refused_total: u64,
    /// PPO metrics of the update.
    pub ppo: PpoMetrics,
    /// What the mixture head drew; absent for the Gaussian head, and if PPO had no samples.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub proposals: Option<ProposalMetrics>,
    /// Episodes that ended since the last report.
    pub episodes: EpisodeMetrics,
    /// Trajectories that arrived, by result.
    pub ingest: IngestCounts,
    /// Messages dropped by the bus.
    pub bus: BusCounts,
    /// Probability of each training blueprint.
    pub task_probabilities: BTreeMap<BlueprintId, f32>,
    /// Present while nothing can be saved and training waits for that.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub not_saved: Option<NotSaved>,
}

/// Why a learner waits: its disk takes nothing.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NotSaved {
    /// Time of the last checkpoint, or of the learner's start, milliseconds since 1970.
    pub since_unix_ms: u64,
    /// The file, and the system's error.
    pub reason: String,
}

/// Means over the minibatches of one PPO update, under their usual names.
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
    /// Part of the entropy from the choice of blocks, nats.
    pub entropy_blocks: f64,
    /// Part of the entropy from the moves of the chosen blocks (expected over the choice), nats.
    pub entropy_moves: f64,
    /// Estimate of KL(reference ‖ current) after the last epoch, nats; the learner's objective defines the reference.
    pub approx_kl: f64,
    /// Fraction of samples whose ratio was clipped in the last epoch, 0 to 1.
    pub clip_fraction: f64,
    /// (Σw)² / (n Σw²) of the importance weights between the policy before the update and the acting policy, 0 to 1; 1
    /// without policy lag.
    pub effective_sample_size: f64,
    /// 1 − Var(target − value) / Var(target) before the update; at most 1, 0 for a constant prediction.
    pub explained_variance: f64,
    /// Norm of the gradient before clipping.
    pub grad_norm: f64,
    /// Learning rate of the update.
    pub learning_rate: f64,
    /// Samples in the batch.
    pub n_samples: u64,
    /// Gradient steps taken.
    pub n_gradient_steps: u64,
    /// Gradient steps skipped because the gradient was not finite.
    pub n_skipped_steps: u64,
    /// Passes over the batch.
    pub n_epochs: u64,
    /// Mean of the value targets, reward units.
    pub value_mean: f64,
    /// Standard deviation of the value targets, reward units.
    pub value_std: f64,
}

/// The mixture head's draws of proposals in the samples of an update. The entropies are those before its first gradient
/// step, means over the samples in which the choice was made, and 0 if there are none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ProposalMetrics {
    /// Entropy of the first gripper's choice among the proposals of its block, nats.
    pub first_proposal_entropy: f64,
    /// Entropy of the second gripper's choice of a block, given the first one's draw, nats.
    pub second_block_entropy: f64,
    /// Entropy of the second gripper's choice among the proposals of its block, nats.
    pub second_proposal_entropy: f64,
    /// Draws of both grippers by kind of proposal: `join`, `detach`, `hold`.
    pub kinds: BTreeMap<String, KindMetrics>,
}

/// Draws of one kind of proposal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct KindMetrics {
    /// Number of draws.
    pub n_draws: u64,
    /// Part of all draws, 0 to 1.
    pub share: f64,
    /// Draws that had a connection to change. For `join`, the blueprint connects the block and its partner, and
    /// they were not connected correctly; for `detach`, they were connected wrongly. `hold` has none.
    pub n_tries: u64,
    /// Part of the tries whose step changed it, 0 to 1: afterwards the two were connected correctly (`join`), or no
    /// longer connected wrongly (`detach`). A way of several steps counts as one success in as many tries. `null` without
    /// tries.
    pub success: Option<f64>,
}

/// Statistics of finished episodes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EpisodeMetrics {
    /// Success rate of all episodes.
    pub success: SuccessRate,
    /// Mean steps per episode, 0 without episodes.
    pub mean_steps: f64,
    /// Mean undiscounted return by term, 0 without episodes.
    pub mean_return: RewardTerms,
    /// Success rate by blueprint; blueprints without episodes are absent.
    pub success_by_blueprint: BTreeMap<BlueprintId, SuccessRate>,
}

/// An actor's state; key `metrics/actor/<id>`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ActorMetrics {
    /// [`METRICS_SCHEMA_VERSION`].
    pub schema_version: u32,
    /// The actor's name.
    pub actor: ActorId,
    /// Start time of the process, ms since 1970.
    pub epoch: u64,
    /// Version of the acting weights.
    pub weights_version: WeightsVersion,
    /// Time since the actor's start, seconds.
    pub elapsed_s: f64,
    /// Worlds stepped in parallel.
    pub n_worlds: u64,
    /// Environment steps so far.
    pub n_env_steps: u64,
    /// Environment steps per second over the last half minute.
    pub env_steps_per_s: f64,
    /// Episodes finished so far.
    pub n_episodes: u64,
    /// Learner's version in its last answer − version of the acting weights, versions.
    pub policy_lag: u64,
    /// Trajectories accepted by the learner so far.
    pub n_trajectories_acked: u64,
    /// Trajectories dropped so far, by reason.
    pub dropped: ActorDrops,
    /// Whether a learner is present.
    pub learner_is_there: bool,
    /// Messages dropped by the bus.
    pub bus: BusCounts,
}

/// Trajectories that an actor dropped, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ActorDrops {
    /// Refused by the learner as stale.
    pub stale_total: u64,
    /// Displaced from a full backlog by newer ones while a learner was present.
    pub full_total: u64,
    /// Refused by the learner as invalid.
    pub invalid_total: u64,
    /// Refused because another live process owns the actor's name; the actor then exits.
    #[serde(default)]
    pub name_taken_total: u64,
    /// Replaced by newer ones while no learner was present, or dropped when the actor ended.
    pub no_learner_total: u64,
    /// No answer after the last attempt.
    pub no_reply_total: u64,
    /// Larger than the limit.
    pub too_large_total: u64,
    /// The episode diverged.
    pub diverged_total: u64,
    /// The session failed.
    pub failed_total: u64,
}

/// The evaluation of one policy on one blueprint; key `metrics/eval/<split>/<blueprint>`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvalBlueprint {
    /// [`METRICS_SCHEMA_VERSION`].
    pub schema_version: u32,
    /// Version of the evaluated weights.
    pub weights_version: WeightsVersion,
    /// Environment steps that the learner had consumed when it published the weights.
    pub n_env_steps: u64,
    /// The goal.
    pub blueprint: BlueprintId,
    /// The goal's split.
    pub split: Split,
    /// The goal's number of blocks.
    pub n_blocks: u64,
    /// Results with actions sampled from the policy.
    pub sampled: EvalOutcome,
    /// Results with the most probable action.
    pub greedy: EvalOutcome,
}

/// Results of episodes with one action mode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EvalOutcome {
    /// Success rate and interval; diverged episodes count as failures.
    pub success: SuccessRate,
    /// Rate of stable successes, which held for several steps in a row at low speed after the grippers let go; diverged
    /// episodes count as failures.
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

impl EvalBlueprint {
    /// Returns the results of each evaluated action mode, greedy first.
    pub fn outcomes(&self) -> impl Iterator<Item = (ActionMode, &EvalOutcome)> {
        evaluated(&self.greedy, &self.sampled, |outcome| outcome)
    }

    /// Returns the results with one action mode; `None` if it was not evaluated.
    pub fn outcome(&self, acting: ActionMode) -> Option<&EvalOutcome> {
        self.outcomes().find(|(evaluated, _)| *evaluated == acting).map(|(_, outcome)| outcome)
    }

    /// Returns the goal's group; `None` for a size outside the paper's groups.
    pub fn group(&self) -> Option<Group> {
        Group::of(self.split, usize::try_from(self.n_blocks).ok()?)
    }
}

fn evaluated<'r, T>(
    greedy: &'r T,
    sampled: &'r T,
    outcome: fn(&T) -> &EvalOutcome,
) -> impl Iterator<Item = (ActionMode, &'r T)> {
    let both = [(ActionMode::Greedy, greedy), (ActionMode::Sampled, sampled)];
    both.into_iter().filter(move |(_, results)| outcome(results).success.n_episodes > 0)
}

/// The evaluation of one policy on all evaluated blueprints; key `metrics/eval/summary`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvalSummary {
    /// [`METRICS_SCHEMA_VERSION`].
    pub schema_version: u32,
    /// Version of the evaluated weights.
    pub weights_version: WeightsVersion,
    /// Environment steps that the learner had consumed when it published the weights.
    pub n_env_steps: u64,
    /// Duration of the evaluation so far, seconds.
    pub elapsed_s: f64,
    /// Whether the evaluation is complete; if not, the results cover some episodes, spread over all blueprints.
    #[serde(default = "complete")]
    pub is_complete: bool,
    /// Episodes of the whole evaluation per action mode, without the reset-free runs.
    #[serde(default)]
    pub n_planned: u64,
    /// Seed of the start states; evaluations with the same seed have the same start states.
    pub seed: u64,
    /// All blueprints.
    pub all: EvalGroup,
    /// The paper's groups in its order, without groups in which no blueprint was evaluated.
    pub groups: Vec<EvalGroup>,
    /// Several goals in a row without a reset; `null` if not requested.
    pub reset_free: Option<EvalResetFree>,
    /// Messages dropped by the bus.
    pub bus: BusCounts,
    /// Videos of episodes; `null` if not requested.
    #[serde(default)]
    pub videos: Option<VideoCounts>,
}

/// Videos of an evaluator since its start. Most videos of an evaluation are written after its summary.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct VideoCounts {
    /// Files written.
    pub written_total: u64,
    /// Episodes waiting to be rendered.
    pub n_waiting: u64,
    /// Episodes dropped because too many waited, or because the evaluator ended first.
    pub dropped_total: u64,
    /// Episodes that could not be rendered, or files that could not be written or removed.
    pub failed_total: u64,
    /// Episodes that were requested but not recorded, because too many recordings were in progress.
    pub unrecorded_total: u64,
    /// Always 0; earlier versions counted small videos for TensorBoard here, and require it.
    pub oversized_total: u64,
}

/// Returns the default of `is_complete`: early versions wrote a summary only at the end of an evaluation.
fn complete() -> bool {
    true
}

/// Results of a group of blueprints.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EvalGroup {
    /// `train 2-6`, `train 7-11`, `train 12-16`, `test 12-16`, `test special`, `validation` or `all`.
    pub name: String,
    /// Number of blueprints.
    pub n_blueprints: u64,
    /// Results with actions sampled from the policy.
    pub sampled: EvalOutcome,
    /// Results with the most probable action.
    pub greedy: EvalOutcome,
}

impl EvalGroup {
    /// Returns the results of each evaluated action mode, greedy first.
    pub fn outcomes(&self) -> impl Iterator<Item = (ActionMode, &EvalOutcome)> {
        evaluated(&self.greedy, &self.sampled, |outcome| outcome)
    }
}

/// Goals evaluated one after the other without resets in between (paper, section "Reset-Free Evaluation").
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EvalResetFree {
    /// Number of worlds.
    pub n_runs: u64,
    /// Number of goals in each world.
    pub n_goals: u64,
    /// Results with actions sampled from the policy.
    pub sampled: EvalRuns,
    /// Results with the most probable action.
    pub greedy: EvalRuns,
}

impl EvalResetFree {
    /// Returns the results of each evaluated action mode, greedy first.
    pub fn outcomes(&self) -> impl Iterator<Item = (ActionMode, &EvalRuns)> {
        evaluated(&self.greedy, &self.sampled, |runs| &runs.outcome)
    }
}

/// Results of reset-free runs with one action mode.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EvalRuns {
    /// All goals of all runs.
    pub outcome: EvalOutcome,
    /// Successes at the first goal of a run, at the second, and so on; empty if this action mode was not evaluated.
    pub n_successes_by_goal: Vec<u64>,
    /// Standard deviation of the success rate between runs.
    pub run_rate_std: f64,
    /// Resets of worlds that had diverged.
    pub n_forced_resets: u64,
}

/// The results of one evaluation of frozen weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvalReport {
    /// All blueprints, groups and reset-free runs.
    pub summary: EvalSummary,
    /// Each blueprint, ordered by split, size and id.
    pub blueprints: Vec<EvalBlueprint>,
}

/// Messages that a session dropped so far, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct BusCounts {
    /// Invalid notices of weights.
    pub notices_invalid_total: u64,
    /// Weights that could not be decoded or broke a rule.
    pub weights_invalid_total: u64,
    /// Valid weights that were not used because they yield no action distribution or do not fit the network.
    #[serde(default)]
    pub weights_refused_total: u64,
    /// Pulls of weights that failed and were retried.
    pub pulls_failed_total: u64,
    /// Queries for weights, metrics, or the history that carried a payload.
    pub queries_invalid_total: u64,
    /// Queries for weights, metrics, or the history refused or dropped because too many came.
    pub queries_dropped_total: u64,
    /// Metrics that were not JSON.
    pub metrics_invalid_total: u64,
    /// Metrics dropped because a reader was too slow.
    pub metrics_dropped_total: u64,
    /// Trajectories that a viewer could not decode.
    pub viewed_invalid_total: u64,
    /// Trajectories dropped because a viewer was too slow.
    pub viewed_dropped_total: u64,
    /// Copies for viewers that could not be sent.
    pub views_failed_total: u64,
    /// Liveliness keys without a valid name, or beyond the number of names that are tracked.
    pub tokens_invalid_total: u64,
}

/// Results of the trajectories that reached a learner. Each is counted in `received_total` and in exactly one other
/// field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct IngestCounts {
    /// All that arrived, valid or not.
    pub received_total: u64,
    /// Accepted by the handler.
    pub accepted_total: u64,
    /// Retries of already accepted ones; acknowledged again, but not handled again.
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

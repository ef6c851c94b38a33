//! Evaluation episodes that another process runs.

use crate::{CanonicalSettings, RewardTerms, Task, Weights};

/// Maximum number of sequences per unit, and of tasks per sequence.
pub const MAX_UNIT_SEQUENCES: usize = 1000;

/// Episodes to run with frozen weights.
#[derive(Clone, Debug, PartialEq)]
pub struct EvalUnit {
    /// Everything other than weights and tasks that affects an episode's result.
    pub settings: CanonicalSettings,
    /// The evaluation, which fixes the weights.
    pub pass: PassId,
    /// The weights, if the remote worker lacks them.
    pub weights: Option<Weights>,
    /// Whether actions are sampled; otherwise they are greedy.
    pub is_sampled: bool,
    /// 1 to [`MAX_UNIT_SEQUENCES`] sequences of 1 to as many tasks. The tasks of a sequence run one after another in
    /// one world.
    pub sequences: Vec<Vec<Task>>,
}

/// Identifies an evaluation of frozen weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PassId {
    /// Start time of the evaluator process, ms since 1970.
    pub epoch: u64,
    /// Index of the evaluation in that process, from 0.
    pub number: u64,
}

/// A remote worker's answer to a unit.
#[derive(Clone, Debug, PartialEq)]
pub enum EvalAnswer {
    /// The episodes, in the shape of the unit's sequences.
    Episodes(Vec<Vec<EvalEpisode>>),
    /// The remote worker does not have the weights of the evaluation.
    NeedsWeights,
    /// The remote worker does not run this evaluator's units, for the given human-readable reason.
    Refused(String),
}

/// An episode run by a remote worker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EvalEpisode {
    /// The end of the episode.
    pub end: End,
    /// Steps until it ended, 1 to 65535.
    pub n_steps: u16,
    /// Undiscounted return by term.
    pub episode_return: RewardTerms,
    /// Whether the world was reset because it had diverged, although the episode should have started without a reset.
    pub forced_reset: bool,
}

/// The end of an episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The blueprint is complete.
    Success {
        /// Whether it was still complete some steps later.
        stable: bool,
    },
    /// The episode reached the time limit.
    TimeLimit,
    /// The physics diverged.
    Diverged,
}

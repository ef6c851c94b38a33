//! Episodes of an evaluation that another process runs.

use crate::{RewardTerms, Task, Weights};

/// Most sequences of a unit, and most tasks of a sequence.
pub const MAX_UNIT_SEQUENCES: usize = 1000;

/// Episodes to be run with frozen weights.
#[derive(Clone, Debug, PartialEq)]
pub struct EvalUnit {
    /// Hash of everything besides weights and tasks that decides what comes of an episode.
    pub setup_hash: u64,
    /// The pass, whose weights are frozen.
    pub pass: PassId,
    /// The weights, for a remote worker that does not have them.
    pub weights: Option<Weights>,
    /// Whether actions are sampled; otherwise the most probable ones are taken.
    pub is_sampled: bool,
    /// 1 to [`MAX_UNIT_SEQUENCES`] sequences of as many tasks; the tasks of a sequence are run one after the other in one world.
    pub sequences: Vec<Vec<Task>>,
}

/// Names a pass over frozen weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PassId {
    /// Start time of the evaluator process, ms since 1970.
    pub epoch: u64,
    /// Counts the passes of that process from 0.
    pub number: u64,
}

/// What a remote worker says to a unit.
#[derive(Clone, Debug, PartialEq)]
pub enum EvalAnswer {
    /// The episodes, in the shape of the unit's sequences.
    Episodes(Vec<Vec<EvalEpisode>>),
    /// It does not have the weights of the pass.
    NeedsWeights,
    /// It will not run units of this evaluator; why, for people.
    Refused(String),
}

/// An episode that a remote worker has run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EvalEpisode {
    /// How it ended.
    pub end: End,
    /// Steps until it ended, 1 to 65535.
    pub n_steps: u16,
    /// Undiscounted return by term.
    pub episode_return: RewardTerms,
    /// It should have begun in the world as it was, but that had diverged.
    pub forced_reset: bool,
}

/// The end of an episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The blueprint stands.
    Success {
        /// Whether it still stood some steps later.
        stable: bool,
    },
    /// The time limit came first.
    TimeLimit,
    /// The physics left the rails.
    Diverged,
}

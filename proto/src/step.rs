//! One control step: the action, the reward by term, and how an episode stands.

use blueprints::{BlockIdx, N_BLOCKS};
use serde::{Deserialize, Serialize};

use crate::N_GRIPPERS;

/// Linear (first three) and angular velocity in the block's own frame, as a fraction of the world's v_max and ω_max.
///
/// Unbounded here (a Gaussian sample); the world clips each entry to [−1, 1].
pub type Move = [f32; 6];

/// What the grippers do for one step (paper, appendix "Action Space").
#[derive(Clone, Debug, PartialEq)]
pub struct Action {
    /// The block that each gripper moves; `None` only for a gripper the world does not have.
    pub choices: [Option<BlockIdx>; N_GRIPPERS],
    /// A move for every block; only the rows of chosen blocks have an effect.
    pub moves: [Move; N_BLOCKS],
}

/// The reward of a step, or a potential, by term (paper, appendix "Rewards").
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RewardTerms {
    /// +1 for each required block pair that is connected as the blueprint says.
    pub connected: f32,
    /// −1 (configurable) for each connection that the blueprint does not have.
    pub wrong: f32,
    /// Dense part from the poses of the magnets that should meet.
    pub magnets: f32,
    /// Dense part from the poses of the blocks that should meet.
    pub blocks: f32,
    /// Penalty for heavy contacts.
    pub force: f32,
}

/// How an episode stands after a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    /// It goes on.
    Running,
    /// The blueprint stands; the value of what follows is 0.
    Success,
    /// The step limit was reached; the value of what follows is V(s_T).
    TimeLimit,
    /// The physics left the rails; the episode is discarded and counted.
    Diverged,
}

impl RewardTerms {
    /// Sum of all terms.
    pub fn total(&self) -> f32 {
        self.connected + self.wrong + self.magnets + self.blocks + self.force
    }
}

//! One control step: the action, the reward by term, and the episode's status.

use blueprints::{BlockIdx, N_BLOCKS};
use serde::{Deserialize, Serialize};

use crate::N_GRIPPERS;

/// Linear (first three) and angular velocity in the block's own frame, as a fraction of the world's v_max and ω_max.
///
/// Not clipped (a Gaussian sample); the world clips each entry to [−1, 1].
pub type Move = [f32; 6];

/// The grippers' commands for one step (paper, appendix "Action Space").
#[derive(Clone, Debug, PartialEq)]
pub struct Action {
    /// The block that each gripper moves; `None` only for an absent gripper.
    pub choices: [Option<BlockIdx>; N_GRIPPERS],
    /// A move for each block; only the rows of chosen blocks have an effect.
    pub moves: [Move; N_BLOCKS],
}

impl Action {
    /// An action without effect: no gripper chooses a block.
    pub const IDLE: Self = Self { choices: [None; N_GRIPPERS], moves: [[0.0; 6]; N_BLOCKS] };
}

/// The reward of a step, or a potential, by term (paper, appendix "Rewards").
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RewardTerms {
    /// +1 for each required block pair that is correctly connected.
    pub connected: f32,
    /// −1 (configurable) for each connection that is not in the blueprint.
    pub wrong: f32,
    /// Dense term from the poses of the magnets that should meet.
    pub magnets: f32,
    /// Dense term from the poses of the blocks that should meet.
    pub blocks: f32,
    /// Penalty for heavy contacts.
    pub force: f32,
}

/// How actions are chosen from the policy's distribution.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ActionMode {
    /// Greedy: the most probable block and the mean move.
    #[default]
    Greedy,
    /// Sampled, as in training. The noise alone can undo a snap, so this underestimates a policy.
    Sampled,
}

/// A text that is not an action mode.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not a way of acting: expected greedy or sampled")]
pub struct InvalidActionMode(pub String);

impl std::fmt::Display for ActionMode {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl ActionMode {
    /// Returns the name: `greedy` or `sampled`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Greedy => "greedy",
            Self::Sampled => "sampled",
        }
    }

    /// Returns the other one.
    pub fn other(self) -> Self {
        if self == Self::Greedy { Self::Sampled } else { Self::Greedy }
    }
}

impl std::str::FromStr for ActionMode {
    type Err = InvalidActionMode;

    fn from_str(text: &str) -> Result<Self, InvalidActionMode> {
        let mode = [Self::Greedy, Self::Sampled].into_iter().find(|mode| mode.name() == text);
        mode.ok_or_else(|| InvalidActionMode(text.to_owned()))
    }
}

/// The status of an episode after a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    /// The episode continues.
    Running,
    /// The blueprint is complete; the value of the next state is 0.
    Success,
    /// The step limit was reached; the value of the next state is V(s_T).
    TimeLimit,
    /// The physics diverged; the episode is discarded and counted.
    Diverged,
}

impl std::ops::Add for RewardTerms {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        let (a, b) = (self.to_array(), other.to_array());
        Self::from_array(std::array::from_fn(|term| a[term] + b[term]))
    }
}

impl RewardTerms {
    /// Returns the terms in the order of the fields.
    pub fn to_array(self) -> [f32; 5] {
        [self.connected, self.wrong, self.magnets, self.blocks, self.force]
    }

    /// Returns the terms of [`RewardTerms::to_array`].
    pub fn from_array([connected, wrong, magnets, blocks, force]: [f32; 5]) -> Self {
        Self { connected, wrong, magnets, blocks, force }
    }

    /// Returns the sum of all terms.
    pub fn total(&self) -> f32 {
        self.connected + self.wrong + self.magnets + self.blocks + self.force
    }
}

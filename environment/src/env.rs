//! What the rest of the system needs of a world.

use blueprints::{BlockIdx, Blueprint, BlueprintId, Catalog};
use proto::{Action, Observation, RewardTerms, Scene, Status, Task};

/// What came of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepResult {
    /// Reward by term; all zero when the episode diverged.
    pub reward: RewardTerms,
    /// How the episode stands.
    pub status: Status,
}

/// Why a task cannot be started.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ResetError {
    /// The goal or the prebuilt structure is not in the catalog.
    #[error("blueprint {0} is not in the catalog")]
    UnknownBlueprint(BlueprintId),
    /// The assignment is no permutation of blocks of one type.
    #[error("the assignment lets block {played_by} play block {block}; it must permute blocks of one type")]
    Assignment {
        /// The catalog's block.
        block: u8,
        /// Who should play it.
        played_by: u8,
    },
    /// A near-goal start that takes off no block or more than all but one.
    #[error("a near-goal start of {blueprint} cannot take off {undone} blocks; it must be 1 to {most}")]
    Undone {
        /// The goal.
        blueprint: BlueprintId,
        /// Blocks to take off.
        undone: u8,
        /// The greatest valid number.
        most: usize,
    },
    /// The world has no state to go on from: it was never reset, or it has diverged.
    #[error("there is no previous state to start from")]
    NothingToKeep,
    /// The blocks do not fit; block `0` found no free place.
    #[error("found no free place for block {}; the arena is too small", u8::from(*.0))]
    NoRoom(BlockIdx),
}

/// An episode that could not be started by any of the tasks that were tried.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("an episode of blueprint {blueprint} cannot be started")]
pub struct StartError {
    /// Goal of the last task.
    pub blueprint: BlueprintId,
    /// Why that failed.
    pub source: ResetError,
}

/// A world of 16 blocks in which episodes take place.
///
/// Deterministic: the same tasks and actions give the same scenes, bit for bit, on one machine.
pub trait Env {
    /// Starts an episode; what follows depends on `task`, `catalog` and the actions only, except for a start "as it is".
    ///
    /// # Errors
    /// When the task does not fit the catalog or the world; the world is then as before.
    fn reset(&mut self, task: &Task, catalog: &Catalog) -> Result<(), ResetError>;

    /// Advances by one control step.
    ///
    /// Any action is accepted: moves are clipped, choices for a gripper that the world does not have are ignored, and
    /// one that is not finite ends the episode as [`Status::Diverged`]. Stepping on after the end is allowed.
    fn step(&mut self, action: &Action) -> StepResult;

    /// The scene after the last reset or step.
    fn scene(&self) -> &Scene;

    /// The goal, on the blocks that the task's assignment gives it.
    fn blueprint(&self) -> &Blueprint;

    /// Steps since the last reset.
    fn n_steps(&self) -> u16;

    /// What an agent sees.
    fn observation(&self) -> Observation<'_> {
        Observation { scene: self.scene(), blueprint: self.blueprint(), n_steps: self.n_steps() }
    }
}

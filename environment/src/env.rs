//! The environment interface that the rest of the system uses.

use blueprints::{BlockIdx, Blueprint, BlueprintId, Catalog};
use proto::{Action, Observation, RewardTerms, Scene, Status, Task};

/// Result of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepResult {
    /// Reward by term; all zero if the episode diverged.
    pub reward: RewardTerms,
    /// Status of the episode after the step.
    pub status: Status,
}

/// Reasons why a task cannot be started.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ResetError {
    /// The goal or the prebuilt structure is not in the catalog.
    #[error("blueprint {0} is not in the catalog")]
    UnknownBlueprint(BlueprintId),
    /// The assignment is not a permutation within each block type, or a near-goal start removes no block or more than
    /// all but one.
    #[error("{0}")]
    Unfit(String),
    /// The world has no state to continue from: it was never reset, or it has diverged.
    #[error("there is no previous state to start from")]
    NothingToKeep,
    /// The blocks do not fit: this one found no free place.
    #[error("found no free place for block {}; the arena is too small", u8::from(*.0))]
    NoRoom(BlockIdx),
}

/// Error of an episode that none of the attempted tasks could start.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("an episode of blueprint {blueprint} cannot be started")]
pub struct StartError {
    /// Goal of the last attempted task.
    pub blueprint: BlueprintId,
    /// Why that task failed.
    pub source: ResetError,
}

/// A world of 16 blocks in which episodes take place.
///
/// Deterministic on one machine: the same tasks and actions give the same scenes, bit for bit.
pub trait Env {
    /// Starts an episode. It depends only on `task`, `catalog`, and the actions, except for a start "as it is".
    ///
    /// # Errors
    /// If the task does not fit the catalog or the world, which then stays unchanged.
    fn reset(&mut self, task: &Task, catalog: &Catalog) -> Result<(), ResetError>;

    /// Advances by one control step.
    ///
    /// Any action is accepted: moves are clipped, choices for a gripper that the world does not have are ignored, and
    /// non-finite moves of a chosen block end the episode as [`Status::Diverged`]. Stepping after the end is allowed.
    fn step(&mut self, action: &Action) -> StepResult;

    /// Returns the scene after the last reset or step.
    fn scene(&self) -> &Scene;

    /// Returns the goal, with its blocks permuted by the task's assignment.
    fn blueprint(&self) -> &Blueprint;

    /// Returns what an agent observes.
    fn observation(&self) -> Observation<'_> {
        Observation { scene: self.scene(), blueprint: self.blueprint() }
    }
}

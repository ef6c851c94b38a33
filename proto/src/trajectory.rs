//! A segment of one episode, sent from an actor to the learner.

use std::fmt;
use std::str::FromStr;

use blueprints::{BlockIdx, BlueprintId, N_BLOCKS};
use serde::{Deserialize, Serialize};

use crate::{Action, Disturbance, N_GRIPPERS, RewardTerms, Scene, Status, WeightsVersion};

/// Name of an actor: 1 to 64 characters of `a-z`, `0-9`, `-`.
///
/// # Example
/// ```
/// use proto::ActorId;
///
/// assert_eq!("actor-1".parse::<ActorId>()?.as_str(), "actor-1");
/// assert!("Actor 1".parse::<ActorId>().is_err());
/// # Ok::<(), proto::trajectory::InvalidActorId>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String")]
pub struct ActorId(String);

/// The start state of an episode (paper, section "Initial State").
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Start {
    /// All blocks scattered on the ground.
    Scattered,
    /// Another blueprint is already built, and the other blocks are scattered.
    Prebuilt(BlueprintId),
    /// The goal is built except for `undone` blocks, which lie near their places (an extension for learning).
    NearGoal {
        /// Number of blocks removed, at least 1.
        undone: u8,
    },
    /// The world stays as the previous episode left it (paper, section "Reset-Free Evaluation").
    AsItIs,
}

/// An episode's goal and start. Together with the seed they determine the initial world.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Task {
    /// The goal.
    pub blueprint: BlueprintId,
    /// `assignment[i]` is the block used for the catalog's block `i`; it permutes only blocks of the same type.
    pub assignment: [BlockIdx; N_BLOCKS],
    /// How the episode begins.
    pub start: Start,
    /// Seed of the reset.
    pub seed: u64,
}

/// One step of a trajectory: the scene, the action, and the reward.
#[derive(Clone, Debug, PartialEq)]
pub struct Transition {
    /// Scene before the action.
    pub scene: Scene,
    /// The action taken.
    pub action: Action,
    /// The slot of the proposal that each gripper's move was drawn from; `None` if it was not drawn from one.
    pub proposals: [Option<u8>; N_GRIPPERS],
    /// Joint log-probability of the action under the acting weights.
    pub behavior_log_prob: f32,
    /// Reward by term.
    pub reward: RewardTerms,
    /// What somebody outside did to the world in this step; no actor does that.
    pub disturbance: Option<Disturbance>,
}

/// The source of an episode's actions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum BehaviorPolicy {
    /// Actions sampled from the policy's distribution, the only source suited to policy gradients.
    #[default]
    Sampled,
    /// The most probable actions.
    Greedy,
    /// The scripted expert.
    Expert,
}

impl fmt::Display for Start {
    /// Uses the start names of `reset` in the Python package.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Scattered => f.write_str("scattered"),
            Self::Prebuilt(id) => write!(f, "prebuilt:{id}"),
            Self::NearGoal { undone } => write!(f, "near-goal:{undone}"),
            Self::AsItIs => f.write_str("as-it-is"),
        }
    }
}

/// The result of a finished episode; part of its last segment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EpisodeStats {
    /// All success conditions held at the last step.
    pub success: bool,
    /// Steps of the whole episode.
    pub n_steps: u16,
    /// Undiscounted return of the whole episode by term.
    pub episode_return: RewardTerms,
}

/// Consecutive steps of one episode.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    /// The actor.
    pub actor: ActorId,
    /// Start time of the actor process, ms since 1970; it distinguishes the sequence numbers of a restarted actor.
    pub epoch: u64,
    /// Sequence number of the actor's trajectories, from 0; with `actor` and `epoch` it identifies the message.
    pub seq: u64,
    /// Version of the weights that acted (the oldest, if they changed within the segment).
    pub weights_version: WeightsVersion,
    /// Hash of the actor's [settings](crate::CanonicalSettings) of policy and world; 0 in recordings, which are not
    /// learned from.
    pub settings_hash: u64,
    /// Goal and start of the episode.
    pub task: Task,
    /// Source of the actions. `behavior_log_prob` is 0 unless actions were sampled.
    pub behavior_policy: BehaviorPolicy,
    /// Index of the first transition in its episode.
    pub first_step: u16,
    /// At least one step.
    pub transitions: Vec<Transition>,
    /// Scene after the last action.
    pub last_scene: Scene,
    /// `Running` if the segment was cut before the episode's end; never `Diverged`.
    pub status: Status,
    /// Present if and only if the episode ended.
    pub episode_stats: Option<EpisodeStats>,
}

/// Returns whether `name` is a valid name of a process or of a run: 1 to 64 characters of `a-z`, `0-9`, `-`.
pub fn is_valid_name(name: &str) -> bool {
    (1..=64).contains(&name.len()) && name.bytes().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == b'-')
}

/// A text that is not an actor name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("actor name {0:?} is not 1 to 64 characters of a-z, 0-9 and -")]
pub struct InvalidActorId(pub String);

impl TryFrom<String> for ActorId {
    type Error = InvalidActorId;

    fn try_from(name: String) -> Result<Self, InvalidActorId> {
        if is_valid_name(&name) { Ok(Self(name)) } else { Err(InvalidActorId(name)) }
    }
}

impl FromStr for ActorId {
    type Err = InvalidActorId;

    fn from_str(name: &str) -> Result<Self, InvalidActorId> {
        Self::try_from(name.to_owned())
    }
}

impl fmt::Display for ActorId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl ActorId {
    /// Returns the name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

//! The agent interface of the policy and the scripted expert, for code that steps worlds.

use blueprints::Blueprint;
use rand::rngs::ChaCha8Rng;

use crate::{Action, ActionMode, N_GRIPPERS, Scene};

/// An agent's observation of a world.
#[derive(Clone, Copy, Debug)]
pub struct Observation<'a> {
    /// The world after its last reset or step.
    pub scene: &'a Scene,
    /// The goal, permuted by the episode's assignment.
    pub blueprint: &'a Blueprint,
}

/// An action with its log-probability and the agent's value estimate.
#[derive(Clone, Debug, PartialEq)]
pub struct Decision {
    /// The chosen action.
    pub action: Action,
    /// The slot of the proposal that each gripper's move was drawn from; `None` if it was not drawn from one.
    pub proposals: [Option<u8>; N_GRIPPERS],
    /// Joint log-probability of the action in the policy's configured form, nats; 0 if the agent has no distribution.
    pub log_prob: f32,
    /// Value of the scene in reward units; 0 if the agent has no critic.
    pub value: f32,
}

/// Chooses actions for many worlds at once.
pub trait Agent {
    /// The error if the agent cannot decide.
    type Error;

    /// Returns one decision per observation, in order.
    ///
    /// `modes` and `rngs` have one entry per observation. A generator is used only if something is drawn, which
    /// [`ActionMode::Greedy`] never does. An entry may belong to a different world in the next call.
    ///
    /// # Errors
    /// If the agent cannot decide for one of the observations; then it returns no decisions at all.
    fn act(
        &mut self,
        observations: &[Observation<'_>],
        modes: &[ActionMode],
        rngs: &mut [ChaCha8Rng],
    ) -> Result<Vec<Decision>, Self::Error>;
}

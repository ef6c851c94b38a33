//! Who acts: what the policy and the scripted expert have in common for whoever steps worlds.

use blueprints::Blueprint;
use rand_chacha::ChaCha8Rng;

use crate::{Action, ActionMode, Scene};

/// What an agent sees of a world.
#[derive(Clone, Copy, Debug)]
pub struct Observation<'a> {
    /// The world after its last reset or step.
    pub scene: &'a Scene,
    /// The goal, on the blocks that the episode's assignment gives it.
    pub blueprint: &'a Blueprint,
    /// Steps since the episode began.
    pub n_steps: u16,
}

/// An action and what the agent thought of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Decision {
    /// What to do.
    pub action: Action,
    /// Joint log-probability of the action in the policy's configured form, nats; 0 if the agent has no distribution.
    pub log_prob: f32,
    /// Value of the scene in reward units; 0 if the agent has no critic.
    pub value: f32,
}

/// Chooses the actions of many worlds at a time.
pub trait Agent {
    /// Why there are no decisions.
    type Error;

    /// Decides for every observation, in their order.
    ///
    /// `modes` and `rngs` hold one entry for each. A generator is touched only where something is drawn, which
    /// [`ActionMode::Greedy`] never does. From one call to the next, a row may turn to another world.
    ///
    /// # Errors
    /// When the agent has no decision for one of the observations; then it has none for any.
    fn act(
        &mut self,
        observations: &[Observation<'_>],
        modes: &[ActionMode],
        rngs: &mut [ChaCha8Rng],
    ) -> Result<Vec<Decision>, Self::Error>;
}

//! Configuration of a whole actor.

use std::sync::Arc;

use blueprints::Catalog;
use environment::{EnvironmentConfig, World};
use policy::{PolicyConfig, PolicyError};
use proto::{ActorId, CanonicalSettings, Valid, Weights};

use crate::config::ActorConfig;
use crate::segment::Identity;

/// Everything that an actor needs besides the bus.
#[derive(Clone, Debug)]
pub struct ActorSetup {
    /// Tasks, worlds, segments, and how they are sent.
    pub config: Valid<ActorConfig>,
    /// The policy that acts; it must match the learner's.
    pub policy: Valid<PolicyConfig>,
    /// The worlds.
    pub environment: Valid<EnvironmentConfig>,
    /// Name among the live actors, which its segments carry.
    pub id: ActorId,
    /// Seed of the run.
    pub seed: u64,
    /// Source of goals and starts; the learner has the same.
    pub catalog: Arc<Catalog>,
}

impl ActorSetup {
    /// Returns the origin of the segments of a process that started at `epoch`, in ms since 1970.
    pub(crate) fn identity(&self, epoch: u64) -> Identity {
        Identity { actor: self.id.clone(), epoch, settings_hash: self.settings().hash() }
    }

    /// Returns the settings that must be the learner's.
    pub fn settings(&self) -> CanonicalSettings {
        CanonicalSettings::of_run(&self.policy, &self.environment)
    }

    /// Checks that weights are of a run with these settings.
    pub(crate) fn check(&self, weights: &Weights) -> Result<(), PolicyError> {
        policy::check_settings(weights.version, &weights.settings, &self.settings())
    }

    /// Creates the worlds of a thread.
    pub(crate) fn worlds(&self) -> Vec<World> {
        (0..self.config.n_worlds).map(|_| World::new(&self.environment)).collect()
    }
}

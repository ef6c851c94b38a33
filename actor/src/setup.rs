//! What an actor is made of.

use blueprints::Catalog;
use environment::EnvironmentConfig;
use policy::PolicyConfig;
use proto::ActorId;

use crate::config::ActorConfig;

/// What an actor needs besides the bus.
#[derive(Clone, Debug)]
pub struct ActorSetup {
    /// Tasks, worlds, segments and how they are sent.
    pub config: ActorConfig,
    /// The policy that acts; it must be the learner's.
    pub policy: PolicyConfig,
    /// The world.
    pub environment: EnvironmentConfig,
    /// Name among the living, which its segments carry.
    pub id: ActorId,
    /// Seed of the run.
    pub seed: u64,
    /// Where goals and starts come from; the learner's has them too.
    pub catalog: &'static Catalog,
}

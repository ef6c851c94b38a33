//! A small actor for tests, in worlds without physics.

use blueprints::{BlueprintId, Catalog};
use environment::EnvironmentConfig;
use proto::{ActorId, Normalization, Trajectory, Valid, Weights, WeightsVersion};

use crate::config::ActorConfig;
use crate::setup::ActorSetup;

#[path = "../../../proto/src/codec/tests/samples.rs"]
#[expect(dead_code)]
mod samples;
#[path = "../../../policy/tests/samples/untrained.rs"]
mod untrained;
#[path = "../../../environment/tests/toy/mod.rs"]
mod world;

pub(crate) use untrained::small_policy;
pub(crate) use world::Toy;

pub(crate) fn id(name: &str) -> BlueprintId {
    BlueprintId::try_from(name.to_owned()).unwrap()
}

pub(crate) fn trajectory() -> Trajectory {
    samples::running("toy", 0)
}

pub(crate) fn actor() -> ActorId {
    ActorId::try_from("toy".to_owned()).unwrap()
}

/// Returns the setup of an actor with short episodes.
pub(crate) fn setup(config: ActorConfig) -> ActorSetup {
    let environment = Valid::new(EnvironmentConfig { episode_steps: 6, ..Default::default() }).unwrap();
    let (config, catalog) = (Valid::new(config).unwrap(), Catalog::builtin().clone());
    ActorSetup { config, policy: small_policy(), environment, id: actor(), seed: 1, catalog }
}

/// Returns untrained weights whose values are `value` on average and whose only task is `2_000`.
pub(crate) fn weights(version: u64, value: f32) -> Weights {
    let normalization = Normalization { value_mean: value, value_std: 1e-3, ..Normalization::default() };
    Weights { version: WeightsVersion(version), normalization, ..untrained::weights() }
}

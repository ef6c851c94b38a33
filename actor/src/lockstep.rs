//! Rollouts that take turns with a learner, on its thread and without the bus: equal seeds then give equal bytes.

use anyhow::Context;
use environment::{EnvironmentConfig, World};
use policy::PolicyConfig;
use proto::{ActorId, Trajectory, Weights};

use crate::config::ActorConfig;
use crate::rollout::{Rollout, RolloutSetup};
use crate::segment::Identity;

/// Name that segments carry as their actor's.
const NAME: &str = "lockstep";

/// The worlds of one thread, which step when they are asked to.
pub struct Lockstep {
    config: ActorConfig,
    policy: PolicyConfig,
    environment: EnvironmentConfig,
    seed: u64,
    /// Made with the first weights.
    rollout: Option<Rollout<'static, World>>,
}

impl Lockstep {
    /// Worlds as configured, whatever the number of threads; `seed` determines tasks and actions.
    pub fn new(config: ActorConfig, policy: PolicyConfig, environment: EnvironmentConfig, seed: u64) -> Self {
        Self { config, policy, environment, seed, rollout: None }
    }

    /// Moves every world by one step, acted by `weights`, and returns the segments that this finished.
    ///
    /// With `restart` all episodes are abandoned first and others begin, which depend on seed and version alone. Worlds are
    /// not part of a checkpoint: a run that writes one restarts there, so that a run resumed from it stays equal.
    ///
    /// # Errors
    /// When a setting is invalid, the weights are of another network, or no task can be started.
    pub fn step(&mut self, weights: &Weights, restart: bool) -> anyhow::Result<Vec<Trajectory>> {
        let seed = self.seed ^ weights.version.0.rotate_left(32);
        let rollout = match &mut self.rollout {
            Some(rollout) => {
                if rollout.version() != weights.version {
                    rollout.set_weights(weights)?;
                }
                if restart {
                    rollout.restart(seed)?;
                }
                rollout
            }
            none => none.insert(first(&self.config, &self.policy, &self.environment, seed, weights)?),
        };
        Ok(rollout.step()?)
    }
}

fn first(
    config: &ActorConfig,
    policy: &PolicyConfig,
    environment: &EnvironmentConfig,
    seed: u64,
    weights: &Weights,
) -> anyhow::Result<Rollout<'static, World>> {
    config.validate().context("invalid actor configuration")?;
    let actor = ActorId::try_from(NAME.to_owned()).context("naming the worlds")?;
    let identity = Identity { actor, epoch: 0, first_seq: 0, seq_step: 1 };
    let setup = RolloutSetup::new(config, policy, environment, identity, seed);
    let worlds: Result<Vec<World>, _> = (0..config.n_worlds).map(|_| World::new(environment)).collect();
    Ok(Rollout::new(setup, worlds.context("invalid environment configuration")?, weights)?)
}

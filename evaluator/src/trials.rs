//! Physical tests of a blueprint: whether it stands, and whether it can be built.

use blueprints::{BlockIdx, Blueprint, Catalog};
use environment::{Env, EnvironmentConfig, StartError, World};
use nalgebra::{UnitQuaternion, Vector3};
use proto::{Action, Start, Task, Valid};

use crate::config::EpisodeConfig;
use crate::episodes::{Follower, evaluate};
use crate::setup::{EvalError, EvalSetup, N_WORLDS, Performer};

/// Maximum distance that a block of a standing blueprint may move, m (0.2 units).
pub const MAX_DRIFT_M: f32 = 0.02;
/// Maximum angle that a block of a standing blueprint may turn, rad.
pub const MAX_TURN_RAD: f32 = 0.1;

/// Duration of a stability test in control steps: two seconds.
const SETTLE_STEPS: usize = 20;
/// Number of positions on the ground, each with its own rotation, in which the blueprint is tested.
const N_PLACES: u64 = 6;
/// Number of episodes in which the expert tries.
const N_EPISODES: u32 = 3;

/// Changes of a built blueprint after two seconds in a world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settling {
    /// Maximum distance that one of its blocks moved, m.
    pub drift_m: f32,
    /// Maximum angle that one of its blocks turned, rad.
    pub turn_rad: f32,
    /// Maximum number of connections broken at the same time.
    pub n_lost: usize,
}

impl Settling {
    /// Whether the blueprint stayed as it was.
    pub fn is_calm(&self) -> bool {
        self.drift_m < MAX_DRIFT_M && self.turn_rad < MAX_TURN_RAD && self.n_lost == 0
    }
}

/// Lets a blueprint stand untouched for two seconds in several positions. Returns the worst of each measure.
///
/// # Errors
/// If the world cannot be created or has no room.
pub fn settle(environment: &Valid<EnvironmentConfig>, blueprint: &Blueprint) -> Result<Settling, EvalError> {
    let mut world = World::new(environment);
    let catalog = Catalog::of_one(blueprint.clone());
    let mut worst = Settling { drift_m: 0.0, turn_rad: 0.0, n_lost: 0 };
    for seed in 0..N_PLACES {
        let id = blueprint.id().clone();
        let assignment = BlockIdx::array(|block| block);
        let task = Task { blueprint: id.clone(), assignment, start: Start::Prebuilt(id.clone()), seed };
        world.reset(&task, &catalog).map_err(|source| StartError { blueprint: id, source })?;
        stand(&mut world, blueprint, &mut worst);
    }
    Ok(worst)
}

/// Lets a blueprint that was just built stand, and raises each measure that is worse than before.
fn stand(world: &mut World, blueprint: &Blueprint, worst: &mut Settling) {
    let before = world.scene().clone();
    for _ in 0..SETTLE_STEPS {
        world.step(&Action::IDLE);
        // Counted at every step, because some broken connections snap together again.
        let n_lost = before.joints.iter().filter(|joint| !world.scene().joints.contains(joint)).count();
        worst.n_lost = worst.n_lost.max(n_lost);
    }
    let after = world.scene();
    for placement in blueprint.placements() {
        let (from, to) = (&before.blocks[placement.block.get()], &after.blocks[placement.block.get()]);
        let moved = Vector3::from(to.position) - Vector3::from(from.position);
        worst.drift_m = worst.drift_m.max(moved.norm());
        let [from, to] = [from, to].map(|pose| UnitQuaternion::new_normalize(pose.orientation.into()));
        worst.turn_rad = worst.turn_rad.max(from.angle_to(&to));
    }
}

/// Lets the expert build a blueprint from scattered starts. Returns the number of successes and the number of tries.
///
/// # Errors
/// If the world cannot be created or has no room.
pub fn try_building(environment: &Valid<EnvironmentConfig>, blueprint: &Blueprint) -> Result<(u64, u64), EvalError> {
    let catalog = Catalog::of_one(blueprint.clone());
    let setup = EvalSetup {
        catalog: &catalog,
        environment: environment.clone(),
        episodes: EpisodeConfig { n_episodes: N_EPISODES, ..EpisodeConfig::default() },
        reset_free: None,
        n_worlds: N_WORLDS,
        seed: 0,
    };
    let report = evaluate(&setup, Performer::Expert, &[blueprint], &Follower::default())?;
    let n_successes = report.blueprints.iter().map(|found| found.greedy.success.n_successes).sum();
    Ok((n_successes, u64::from(N_EPISODES)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_falls_over_is_not_calm() {
        // The giraffe's tail hangs from two magnets, which are too weak for twice its weight.
        let mut weak = EnvironmentConfig::default();
        weak.magnets.break_force_n = 1.0;
        weak.physics.density_kgpm3 *= 2.0;
        let blueprint = Catalog::builtin().get(&"literal_14_000".parse().unwrap()).unwrap();
        assert!(!settle(&Valid::new(weak).unwrap(), blueprint).unwrap().is_calm());
    }
}

//! Tries the weights of an update before they are published, as whoever acts with them would.

use blueprints::{Blueprint, Catalog};
use policy::{Policy, PolicyError};
use proto::{ActionMode, Agent, Observation, Scene, Trajectory, Weights};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Maximum number of scenes from the update's own batch on which its weights are tried.
const N_SCENES: usize = 16;

/// Scenes from a batch, each with its goal and its trajectory's fingerprint.
pub(crate) struct Trial(Vec<(Scene, Blueprint, u64)>);

impl Trial {
    /// Takes scenes from trajectories evenly over the batch.
    pub(crate) fn new(trajectories: &[Trajectory], catalog: &Catalog) -> Self {
        let last = |trajectory: &Trajectory| {
            let blueprint = catalog.get(&trajectory.task.blueprint)?.permuted(&trajectory.task.assignment);
            Some((trajectory.last_scene.clone(), blueprint, trajectory.fingerprint()))
        };
        let every = trajectories.len().div_ceil(N_SCENES).max(1);
        Self(trajectories.iter().step_by(every).filter_map(last).collect())
    }

    /// Leaves out the scenes of refused trajectories, which say nothing about the weights.
    pub(crate) fn leave_out(&mut self, refused: &[u64]) {
        self.0.retain(|(_, _, fingerprint)| !refused.contains(fingerprint));
    }

    /// Loads the weights into `policy` and acts once in every scene.
    ///
    /// # Errors
    /// Why no policy can act with the weights.
    pub(crate) fn of(&self, weights: &Weights, policy: &mut Policy) -> Result<(), PolicyError> {
        policy.load(weights)?;
        let observations: Vec<Observation<'_>> =
            self.0.iter().map(|(scene, blueprint, _)| Observation { scene, blueprint }).collect();
        let n = observations.len();
        let mut unused = vec![ChaCha8Rng::seed_from_u64(0); n];
        policy.act(&observations, &vec![ActionMode::Greedy; n], &mut unused).map(drop)
    }
}

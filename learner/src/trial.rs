//! Tries the weights of an update before they are published, as whoever acts with them would.

use policy::{Policy, PolicyError};
use proto::{ActionMode, Agent, Observation, Weights};
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;

use crate::batch::Segment;

/// Maximum number of scenes from the update's own batch on which its weights are tried.
const N_SCENES: usize = 16;

/// Loads the weights into `policy`, and acts once after each of a few segments, evenly over the batch.
pub(crate) fn act(weights: &Weights, policy: &mut Policy, segments: &[Segment]) -> Result<(), PolicyError> {
    policy.load(weights)?;
    let every = segments.len().div_ceil(N_SCENES).max(1);
    let observations: Vec<Observation<'_>> = segments.iter().step_by(every).map(Segment::last_observation).collect();
    let n = observations.len();
    let mut unused: Vec<ChaCha8Rng> = (0..n).map(|_| ChaCha8Rng::seed_from_u64(0)).collect();
    policy.act(&observations, &vec![ActionMode::Greedy; n], &mut unused).map(drop)
}

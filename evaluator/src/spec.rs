//! Which episodes are run: each follows from a seed, its goal, its start, and its number.

use blueprints::hash::fnv1a;
use blueprints::{Blueprint, BlueprintId, Catalog, Split};
use environment::sample_assignment;
use proto::{Start, Task};
use rand::rngs::ChaCha8Rng;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};

use crate::config::Starts;

/// An episode to run.
#[derive(Clone, Debug)]
pub(crate) struct EpisodeSpec {
    pub(crate) task: Task,
    pub(crate) split: Split,
    pub(crate) n_blocks: usize,
}

impl EpisodeSpec {
    /// Creates episode `idx` of a goal, with a start chosen by `starts`.
    pub(crate) fn one_of(catalog: &Catalog, blueprint: &Blueprint, starts: Starts, seed: u64, idx: u64) -> Self {
        let mut spec = Self::new(blueprint, Start::Scattered, seed, idx);
        let prebuilt = match starts {
            Starts::Scattered => false,
            Starts::Prebuilt => true,
            Starts::Mixed => idx % 5 == 4,
        };
        let mut others = catalog.of_split(Split::Train).to_vec();
        others.retain(|other| other.id() != blueprint.id());
        // A separate generator keeps the rest of the task independent of its start.
        let mut rng = ChaCha8Rng::seed_from_u64(spec.task.seed);
        if prebuilt && let Some(other) = others.choose(&mut rng) {
            spec.task.start = Start::Prebuilt(other.id().clone());
        }
        spec
    }

    /// Creates episode `episode_idx` of a goal; only `seed`, the goal, `start`, and `episode_idx` determine it.
    pub(crate) fn new(blueprint: &Blueprint, start: Start, seed: u64, episode_idx: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(episode_seed(seed, blueprint.id(), episode_idx));
        let assignment = sample_assignment(&mut rng);
        let task = Task { blueprint: blueprint.id().clone(), assignment, start, seed: rng.random() };
        Self { task, split: blueprint.split(), n_blocks: blueprint.n_blocks() }
    }
}

/// Hashes everything that identifies an episode into the seed of its task's generator.
fn episode_seed(seed: u64, blueprint: &BlueprintId, episode_idx: u64) -> u64 {
    fnv1a(seed.to_le_bytes().into_iter().chain(blueprint.as_str().bytes()).chain(episode_idx.to_le_bytes()))
}

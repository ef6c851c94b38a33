//! Task sampling: the learner's probabilities, restricted by a filter, and the mix of starts.

use std::collections::BTreeMap;

use blueprints::{Blueprint, BlueprintId, Catalog, Split};
use environment::sample_assignment;
use environment::vec_env::draw_weighted;
use proto::{Start, Task, settings};
use rand::RngExt;
use rand::rngs::ChaCha8Rng;
use rand::seq::IndexedRandom;
use serde::{Deserialize, Serialize};

settings! {
    /// Which training blueprints are goals, and how their episodes begin.
    ///
    /// All episodes without a prebuilt start begin scattered.
    pub struct TaskConfig {
        /// The goals.
        pub filter: TaskFilter = TaskFilter::All;
        /// Probability that another training blueprint is built at the start (paper, "Initial State").
        pub prebuilt_probability: f64 = 0.2, in 0.0..=1.0;
        /// The blueprints that may be built at the start.
        pub prebuilt_filter: TaskFilter = TaskFilter::All;
    }
}

/// A selection of training blueprints.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum TaskFilter {
    /// All blueprints of the training split.
    #[default]
    All,
    /// Training blueprints with a number of blocks in the range.
    Sizes {
        /// Minimum number of blocks.
        min: usize,
        /// Maximum number of blocks.
        max: usize,
    },
    /// The blueprints with these ids.
    Blueprints(Vec<BlueprintId>),
}

/// Reasons why a filter selects no goals.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FilterError {
    /// An id that is not in the training split, or that of a held-out structure.
    #[error("blueprint {0} is not in the training split of the catalog")]
    NotForTraining(BlueprintId),
    /// No training blueprint has a size in the range.
    #[error("no training blueprint has between {0} and {1} blocks")]
    NoSuchSize(usize, usize),
    /// The list of blueprints is empty.
    #[error("the list of goals is empty")]
    Empty,
}

/// Draws tasks.
#[derive(Clone, Debug)]
pub struct TaskSampler {
    config: TaskConfig,
    /// Goals in catalog order with their probability. Probabilities need not sum to 1.
    goals: Vec<(BlueprintId, f64)>,
    /// Blueprints that may be built at the start, whatever the goals are.
    prebuilt: Vec<BlueprintId>,
}

impl TaskFilter {
    /// Returns the ids that the filter selects, sorted and unique.
    ///
    /// # Errors
    /// If an id is not a training blueprint, or nothing is selected.
    pub fn select(&self, catalog: &Catalog) -> Result<Vec<BlueprintId>, FilterError> {
        let training = catalog.of_split(Split::Train);
        let mut ids: Vec<BlueprintId> = match self {
            Self::All => training.iter().map(|blueprint| blueprint.id().clone()).collect(),
            Self::Sizes { min, max } => training
                .iter()
                .filter(|blueprint| (*min..=*max).contains(&blueprint.n_blocks()))
                .map(|blueprint| blueprint.id().clone())
                .collect(),
            Self::Blueprints(ids) => {
                let trainable =
                    |blueprint: &Blueprint| blueprint.split() == Split::Train && catalog.is_for_training(blueprint);
                let known = |id: &BlueprintId| catalog.get(id).is_some_and(trainable);
                if let Some(unknown) = ids.iter().find(|id| !known(id)) {
                    return Err(FilterError::NotForTraining(unknown.clone()));
                }
                ids.clone()
            }
        };
        ids.sort();
        ids.dedup();
        match (ids.is_empty(), self) {
            (false, _) => Ok(ids),
            (true, Self::Sizes { min, max }) => Err(FilterError::NoSuchSize(*min, *max)),
            (true, _) => Err(FilterError::Empty),
        }
    }
}

impl TaskSampler {
    /// Creates a sampler that is uniform over the goals until it receives probabilities.
    ///
    /// # Errors
    /// If a filter selects nothing or an unknown blueprint.
    pub fn new(config: &TaskConfig, catalog: &Catalog) -> Result<Self, FilterError> {
        let goals = config.filter.select(catalog)?.into_iter().map(|id| (id, 1.0)).collect();
        Ok(Self { config: config.clone(), goals, prebuilt: config.prebuilt_filter.select(catalog)? })
    }

    /// Adopts the learner's curriculum: its probabilities, restricted to the goals and uniform if none remain.
    pub fn follow(&mut self, probabilities: &BTreeMap<BlueprintId, f32>) {
        for (id, probability) in &mut self.goals {
            *probability = probabilities.get(id).map_or(0.0, |&p| f64::from(p)).max(0.0);
        }
        let total: f64 = self.goals.iter().map(|(_, probability)| probability).sum();
        if !(total.is_finite() && total > 0.0) {
            self.goals.iter_mut().for_each(|(_, probability)| *probability = 1.0);
        }
    }

    /// Draws the next task.
    pub fn sample(&self, rng: &mut ChaCha8Rng) -> Task {
        let blueprint = draw_weighted(&self.goals, rng);
        // Equal blocks are shuffled in every episode, because the policy sees slot numbers.
        let assignment = sample_assignment(rng);
        let start = self.draw_start(blueprint, rng);
        Task { blueprint: blueprint.clone(), assignment, start, seed: rng.random() }
    }

    fn draw_start(&self, goal: &BlueprintId, rng: &mut ChaCha8Rng) -> Start {
        if rng.random::<f64>() >= self.config.prebuilt_probability {
            return Start::Scattered;
        }
        let others: Vec<&BlueprintId> = self.prebuilt.iter().filter(|id| *id != goal).collect();
        others.choose(rng).map_or(Start::Scattered, |&id| Start::Prebuilt(id.clone()))
    }
}

#[cfg(test)]
mod tests;

//! Draws the next episode from a world's generator: goal, assignment of blocks, and start.

use std::ops::RangeInclusive;

use blueprints::{BlockIdx, Blueprint, BlueprintId, Catalog, N_BLOCKS, Split};
use environment::sample_assignment;
use environment::vec_env::draw_weighted;
use proto::{Start, Task};
use rand::RngExt;
use rand::rngs::ChaCha8Rng;
use rand::seq::IndexedRandom;

use crate::goals::{GoalError, Goals, known_id};

/// Distribution of goals and starts.
#[derive(Clone, Debug)]
pub(crate) struct Tasks {
    pub(crate) goals: Goals,
    /// Start rules with weights, which are nonnegative and have a positive sum.
    starts: Vec<(StartRule, f64)>,
    /// Blueprints that may be prebuilt: the training split, except those that a goal replaced in the catalog.
    prebuilt: Vec<BlueprintId>,
    /// Whether equal blocks swap roles between episodes.
    pub(crate) shuffle_blocks: bool,
}

/// Properties of one episode that are given instead of drawn.
#[derive(Clone, Debug, Default)]
pub(crate) struct Wish {
    goal: Option<BlueprintId>,
    start: Option<StartRule>,
}

/// A start rule.
#[derive(Clone, Debug, PartialEq)]
enum StartRule {
    Scattered,
    /// This blueprint is prebuilt, or a random training blueprint other than the goal.
    Prebuilt(Option<BlueprintId>),
    /// The goal is prebuilt except for this many blocks, limited to one less than its total.
    NearGoal(RangeInclusive<u8>),
    AsItIs,
}

/// Why start rules are rejected.
#[derive(Debug, thiserror::Error)]
pub(crate) enum StartsError {
    #[error(
        "start {0:?} is unknown: expected scattered, prebuilt, prebuilt:ID, near-goal, near-goal:N, near-goal:M-N \
         (1 to 15 blocks), or as-it-is"
    )]
    Unknown(String),
    #[error(transparent)]
    Blueprint(#[from] GoalError),
    #[error("start {0:?}")]
    Prebuilt(String, #[source] Box<GoalError>),
    #[error("the weight of start {start:?} is {weight}: expected a finite number that is not negative")]
    Weight { start: String, weight: f64 },
    #[error("starts has no positive weight: expected at least one")]
    Empty,
}

impl StartRule {
    /// Parses a start rule, with blueprints of the catalog or the generator.
    fn parse(text: &str, catalog: &Catalog) -> Result<Self, StartsError> {
        let unknown = || StartsError::Unknown(text.to_owned());
        let (kind, detail) = text.split_once(':').map_or((text, None), |(kind, detail)| (kind, Some(detail)));
        match (kind, detail) {
            ("scattered", None) => Ok(Self::Scattered),
            ("as-it-is", None) => Ok(Self::AsItIs),
            ("prebuilt", None) => Ok(Self::Prebuilt(None)),
            ("prebuilt", Some(id)) => {
                let id = known_id(catalog, id).map_err(|error| StartsError::Prebuilt(text.to_owned(), error.into()))?;
                Ok(Self::Prebuilt(Some(id)))
            }
            // The default in training.
            ("near-goal", None) => Ok(Self::NearGoal(1..=2)),
            ("near-goal", Some(range)) => {
                let (fewest, most) = range.split_once('-').unwrap_or((range, range));
                let [fewest, most] = [fewest, most].map(|n| n.parse().ok().filter(|n| (1..N_BLOCKS as u8).contains(n)));
                let (fewest, most) = fewest.zip(most).filter(|(fewest, most)| fewest <= most).ok_or_else(unknown)?;
                Ok(Self::NearGoal(fewest..=most))
            }
            _ => Err(unknown()),
        }
    }
}

impl Wish {
    /// Creates a wish for an episode with this goal and this start; `None` leaves the choice to chance.
    pub(crate) fn new(tasks: &Tasks, goal: Option<&str>, start: Option<&str>) -> Result<Self, StartsError> {
        let catalog = &tasks.goals.catalog;
        let goal = goal.map(|name| known_id(catalog, name)).transpose()?;
        let start = start.map(|text| StartRule::parse(text, catalog)).transpose()?;
        Ok(Self { goal, start })
    }

    /// Returns whether the start is asked for, not drawn.
    pub(crate) fn has_start(&self) -> bool {
        self.start.is_some()
    }
}

impl Tasks {
    /// Creates a distribution with equally likely goals and weighted starts.
    pub(crate) fn new(goals: Goals, starts: &[(String, f64)], shuffle_blocks: bool) -> Result<Self, StartsError> {
        let mut rules = Vec::new();
        for (start, weight) in starts {
            if !(weight.is_finite() && *weight >= 0.0) {
                return Err(StartsError::Weight { start: start.clone(), weight: *weight });
            }
            rules.push((StartRule::parse(start, &goals.catalog)?, *weight));
        }
        if !rules.iter().any(|(_, weight)| *weight > 0.0) {
            return Err(StartsError::Empty);
        }
        let training = Catalog::builtin().of_split(Split::Train).into_iter().map(Blueprint::id);
        let prebuilt = training.filter(|id| goals.catalog.get(id).is_some()).cloned().collect();
        Ok(Self { goals, starts: rules, prebuilt, shuffle_blocks })
    }

    /// Draws an episode.
    pub(crate) fn draw(&self, wish: &Wish, rng: &mut ChaCha8Rng) -> Task {
        let ids = &self.goals.ids;
        let blueprint = wish.goal.as_ref().unwrap_or_else(|| &ids[rng.random_range(0..ids.len())]).clone();
        let assignment = if self.shuffle_blocks { sample_assignment(rng) } else { BlockIdx::array(|block| block) };
        let start = wish.start.as_ref().unwrap_or_else(|| draw_weighted(&self.starts, rng));
        let start = match start {
            StartRule::Scattered => Start::Scattered,
            StartRule::AsItIs => Start::AsItIs,
            StartRule::Prebuilt(Some(id)) => Start::Prebuilt(id.clone()),
            StartRule::Prebuilt(None) => {
                let others: Vec<&BlueprintId> = self.prebuilt.iter().filter(|id| **id != blueprint).collect();
                // User goals may have replaced all of them. Training also falls back to scattered starts then.
                others.choose(rng).map_or(Start::Scattered, |&id| Start::Prebuilt(id.clone()))
            }
            StartRule::NearGoal(undone) => {
                let most = u8::try_from(self.goals.n_blocks(&blueprint)).unwrap_or(u8::MAX).saturating_sub(1).max(1);
                let [fewest, most] = [undone.start(), undone.end()].map(|n| (*n).min(most));
                Start::NearGoal { undone: rng.random_range(fewest..=most) }
            }
        };
        Task { blueprint, assignment, start, seed: rng.random() }
    }
}

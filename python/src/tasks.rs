//! What the next episode is: a goal, who plays its blocks, and how it begins, drawn from a world's generator.

use std::ops::RangeInclusive;

use blueprints::{BlockIdx, Blueprint, BlueprintId, Catalog, N_BLOCKS, Split};
use environment::sample_assignment;
use proto::{Start, Task};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::goals::{GoalError, Goals, known_id};

/// Goals and starts that are drawn.
#[derive(Clone, Debug)]
pub(crate) struct Tasks {
    pub(crate) goals: Goals,
    /// Ways to begin, with weights that are not negative and have a positive sum.
    starts: Vec<(StartRule, f64)>,
    /// What may stand at the start: the training split, but for what one of the goals has replaced in the catalog.
    prebuilt: Vec<BlueprintId>,
    /// Whether equal blocks swap roles from episode to episode.
    shuffle_blocks: bool,
}

/// What is asked of one episode instead of being drawn.
#[derive(Clone, Debug, Default)]
pub(crate) struct Wish {
    goal: Option<BlueprintId>,
    start: Option<StartRule>,
}

/// A way to begin.
#[derive(Clone, Debug, PartialEq)]
enum StartRule {
    Scattered,
    /// This one stands, or another training blueprint than the goal.
    Prebuilt(Option<BlueprintId>),
    /// The goal stands but for so many blocks; one block less than it has is the limit.
    NearGoal(RangeInclusive<u8>),
    AsItIs,
}

/// Why starts are refused.
#[derive(Debug, thiserror::Error)]
pub(crate) enum StartsError {
    /// A text that is no way to begin.
    #[error(
        "start {0:?} is unknown: expected scattered, prebuilt, prebuilt:ID, near-goal, near-goal:N, near-goal:M-N \
         (1 to 15 blocks), or as-it-is"
    )]
    Unknown(String),
    /// A blueprint that nobody knows.
    #[error(transparent)]
    Blueprint(#[from] GoalError),
    /// A weight that is none.
    #[error("the weight of start {start:?} is {weight}: expected a finite number that is not negative")]
    Weight {
        /// The way to begin.
        start: String,
        /// Its weight.
        weight: f64,
    },
    /// Nothing can be drawn.
    #[error("no start has a positive weight")]
    Empty,
}

impl StartRule {
    /// The way to begin that a text names, with blueprints of the catalog or the generator.
    ///
    /// # Errors
    /// When it is unknown, or its blueprint is.
    fn parse(text: &str, catalog: &Catalog) -> Result<Self, StartsError> {
        let unknown = || StartsError::Unknown(text.to_owned());
        let (kind, detail) = text.split_once(':').map_or((text, None), |(kind, detail)| (kind, Some(detail)));
        match (kind, detail) {
            ("scattered", None) => Ok(Self::Scattered),
            ("as-it-is", None) => Ok(Self::AsItIs),
            ("prebuilt", None) => Ok(Self::Prebuilt(None)),
            ("prebuilt", Some(id)) => Ok(Self::Prebuilt(Some(known_id(catalog, id)?))),
            // As in training by default.
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
    /// An episode of a goal or a start, either if it is named.
    ///
    /// # Errors
    /// When one of them is unknown.
    pub(crate) fn new(tasks: &Tasks, goal: Option<&str>, start: Option<&str>) -> Result<Self, StartsError> {
        let catalog = &tasks.goals.catalog;
        let goal = goal.map(|name| known_id(catalog, name)).transpose()?;
        let start = start.map(|text| StartRule::parse(text, catalog)).transpose()?;
        Ok(Self { goal, start })
    }
}

impl Tasks {
    /// Every goal equally likely, and starts by their weights.
    ///
    /// # Errors
    /// When a start is unknown or nothing has a positive weight.
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
        let assignment = if self.shuffle_blocks { sample_assignment(rng) } else { as_they_are() };
        let start = wish.start.as_ref().unwrap_or_else(|| self.draw_rule(rng));
        let start = match start {
            StartRule::Scattered => Start::Scattered,
            StartRule::AsItIs => Start::AsItIs,
            StartRule::Prebuilt(Some(id)) => Start::Prebuilt(id.clone()),
            StartRule::Prebuilt(None) => {
                let others: Vec<&BlueprintId> = self.prebuilt.iter().filter(|id| **id != blueprint).collect();
                // Goals of one's own may have replaced all of them. Training begins scattered then, too.
                if others.is_empty() {
                    Start::Scattered
                } else {
                    Start::Prebuilt(others[rng.random_range(0..others.len())].clone())
                }
            }
            StartRule::NearGoal(undone) => {
                let most = u8::try_from(self.goals.n_blocks(&blueprint)).unwrap_or(u8::MAX).saturating_sub(1).max(1);
                let [fewest, most] = [undone.start(), undone.end()].map(|n| (*n).min(most));
                Start::NearGoal { undone: rng.random_range(fewest..=most) }
            }
        };
        Task { blueprint, assignment, start, seed: rng.random() }
    }

    fn draw_rule(&self, rng: &mut ChaCha8Rng) -> &StartRule {
        let total: f64 = self.starts.iter().map(|(_, weight)| weight).sum();
        let mut rest = rng.random::<f64>() * total;
        let drawn = self.starts.iter().find(|(_, weight)| {
            rest -= weight;
            rest < 0.0
        });
        // Rounding may leave a rest of about 0 behind the last start that has a weight.
        let last = self.starts.iter().rev().find(|(_, weight)| *weight > 0.0);
        &drawn.or(last).expect("a start has a positive weight").0
    }
}

fn as_they_are() -> [BlockIdx; N_BLOCKS] {
    let mut blocks = BlockIdx::all();
    std::array::from_fn(|_| blocks.next().expect("there are as many indices as blocks"))
}

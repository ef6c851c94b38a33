//! What an evaluation is made of besides who acts, and why it may have no result.

use std::convert::Infallible;

use blueprints::Catalog;
use environment::{EnvironmentConfig, StartError};
use policy::{PolicyConfig, PolicyError};
use proto::InvalidSetting;
use proto::config_hash;
use runlog::RunPaths;

use crate::config::{EpisodeConfig, EvaluatorConfig, ResetFreeConfig};

/// All that an evaluation needs besides who acts and the blueprints.
#[derive(Clone, Debug)]
pub struct EvalSetup<'c> {
    /// Where blueprints come from.
    pub catalog: &'c Catalog,
    /// The world.
    pub environment: EnvironmentConfig,
    /// How episodes are run.
    pub episodes: EpisodeConfig,
    /// Reset-free runs as well, when given.
    pub reset_free: Option<ResetFreeConfig>,
    /// Seed of start states and sampled actions: evaluations with the same seed can be compared episode by episode.
    pub seed: u64,
}

/// Why an evaluation has no result.
#[derive(Debug, thiserror::Error)]
pub enum EvalError {
    /// The policy cannot be made or refuses the weights.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// The world cannot be made.
    #[error(transparent)]
    Environment(#[from] InvalidSetting),
    /// A start state cannot be made.
    #[error(transparent)]
    Start(#[from] StartError),
    /// No training blueprint is large enough for the reset-free runs.
    #[error("no training blueprint has {min_blocks} blocks or more for the reset-free runs")]
    NoGoals {
        /// As configured.
        min_blocks: usize,
    },
    /// The caller asked for the end.
    #[error("the evaluation was interrupted")]
    Interrupted,
}

impl From<Infallible> for EvalError {
    fn from(never: Infallible) -> Self {
        match never {}
    }
}

/// What an evaluator process needs besides the bus.
#[derive(Clone, Debug)]
pub struct EvaluatorSetup {
    /// When, on what and how.
    pub config: EvaluatorConfig,
    /// The policy; it must be the learner's.
    pub policy: PolicyConfig,
    /// The world.
    pub environment: EnvironmentConfig,
    /// Name among the living: 1 to 64 characters of `a-z`, `0-9`, `-`.
    pub id: String,
    /// Seed of start states and sampled actions.
    pub seed: u64,
    /// The folder in which reports are kept; none keeps nothing.
    pub records: Option<RunPaths>,
    /// Where goals and starts come from.
    pub catalog: &'static Catalog,
}

/// Hash of everything besides weights and tasks that decides what comes of an episode.
pub(crate) fn setup_hash(setup: &EvaluatorSetup) -> u64 {
    let catalog = setup.catalog.iter().map(|blueprint| (blueprint.id(), blueprint.canonical_hash()));
    let catalog: Vec<_> = catalog.collect();
    config_hash(&(env!("CARGO_PKG_VERSION"), &setup.environment, setup.policy.hash(), catalog))
}

//! The setup of an evaluation, and its errors.

use std::sync::Arc;

use blueprints::Catalog;
use environment::{EnvironmentConfig, StartError};
use policy::{PolicyConfig, PolicyError};
use proto::{Valid, Weights};
use runlog::RunPaths;

use crate::config::{EpisodeConfig, EvaluatorConfig, MIN_BLOCKS, ResetFreeConfig};

/// Worlds per thread, unless the agent gains nothing from several.
pub const N_WORLDS: usize = 20;

/// Everything that an evaluation needs except the agent and the blueprints.
#[derive(Clone, Debug)]
pub struct EvalSetup<'c> {
    /// The catalog of blueprints.
    pub catalog: &'c Catalog,
    /// The world.
    pub environment: Valid<EnvironmentConfig>,
    /// How episodes are run.
    pub episodes: EpisodeConfig,
    /// Reset-free runs in addition to the episodes, if any.
    pub reset_free: Option<ResetFreeConfig>,
    /// Worlds per thread, usually [`N_WORLDS`]; each step is one forward pass over all of them.
    pub n_worlds: usize,
    /// Seed of start states and sampled actions: evaluations with the same seed can be compared episode by episode.
    pub seed: u64,
}

/// The agent that acts in an episode.
#[derive(Clone, Copy, Debug)]
pub enum Performer<'p> {
    /// The scripted expert.
    Expert,
    /// A policy with this configuration and these weights.
    Policy(&'p Valid<PolicyConfig>, &'p Weights),
}

/// Why an evaluation has no result.
#[derive(Debug, thiserror::Error)]
pub enum EvalError {
    /// The policy cannot be created or refuses the weights.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// A start state cannot be created.
    #[error(transparent)]
    Start(#[from] StartError),
    /// No training blueprint is large enough for the reset-free runs.
    #[error("no training blueprint has {MIN_BLOCKS} blocks or more for the reset-free runs")]
    NoGoals,
    /// The caller stopped the evaluation.
    #[error("the evaluation was interrupted")]
    Interrupted,
}

/// Everything that an evaluator process needs except the bus.
#[derive(Clone, Debug)]
pub struct EvaluatorSetup {
    /// When, on what, and how to evaluate.
    pub config: Valid<EvaluatorConfig>,
    /// The policy, which must match the learner's.
    pub policy: Valid<PolicyConfig>,
    /// The world.
    pub environment: Valid<EnvironmentConfig>,
    /// Unique name of the process on the bus: 1 to 64 characters of `a-z`, `0-9`, `-`.
    pub id: String,
    /// Seed of start states and sampled actions.
    pub seed: u64,
    /// The run's folder for the reports; `None` keeps no records.
    pub records: Option<RunPaths>,
    /// The catalog of goals and starts.
    pub catalog: Arc<Catalog>,
}

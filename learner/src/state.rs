//! The state of a learner except its network and optimizer, stored in `state.json`.

use policy::normalization::FeatureMoments;
use proto::{CanonicalSettings, Normalization, Weights, WeightsVersion};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::adam::LearningRate;
use crate::curriculum::Curriculum;
use crate::mailbox::MailboxCounts;
use crate::normalization::ValueStatistics;
use crate::reverse::ReverseCurriculum;

/// Counters, statistics, curriculum, and random number generator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearnerState {
    /// Version of the parameters.
    pub version: WeightsVersion,
    /// Environment steps so far.
    pub n_env_steps: u64,
    /// Updates so far.
    pub n_updates: u64,
    /// Episodes that ended so far.
    pub n_episodes: u64,
    /// Learning rate of the next update.
    pub learning_rate: LearningRate,
    /// Random number generator that shuffles the minibatches.
    pub rng: ChaCha8Rng,
    /// Task probabilities.
    pub curriculum: Curriculum,
    /// Reverse curriculum; empty if it is off.
    #[serde(default)]
    pub reverse: ReverseCurriculum,
    /// Statistics of node, edge, and global features.
    pub features: FeatureMoments,
    /// Number of scenes in `features`.
    pub n_feature_scenes: u64,
    /// Statistics of the value targets.
    pub values: ValueStatistics,
    /// Number of trajectories by result.
    pub mailbox: MailboxCounts,
    /// Normalization that belongs to the parameters.
    #[serde(with = "NormalizationFields")]
    pub normalization: Normalization,
}

impl LearnerState {
    /// Returns the frozen policy with these `parameters`.
    pub(crate) fn weights(&self, network_hash: u64, settings: CanonicalSettings, parameters: Vec<f32>) -> Weights {
        Weights {
            version: self.version,
            n_env_steps: self.n_env_steps,
            network_hash,
            settings,
            parameters,
            normalization: self.normalization.clone(),
            task_probabilities: self.curriculum.probabilities(),
            reverse_reach: self.reverse.reach(),
        }
    }
}

/// The serde form of [`Normalization`], which itself only has a wire form.
#[derive(Serialize, Deserialize)]
#[serde(remote = "Normalization", deny_unknown_fields)]
pub(crate) struct NormalizationFields {
    feature_mean: [Vec<f32>; 3],
    feature_std: [Vec<f32>; 3],
    value_mean: f32,
    value_std: f32,
}

//! The state of a learner except its network and optimizer, stored in `state.json`.

use policy::PolicyConfig;
use policy::normalization::{self, FeatureMoments};
use proto::setting::Setting;
use proto::{CanonicalSettings, InvalidSetting, Normalization, SavedRng, Weights, WeightsVersion};
use serde::{Deserialize, Serialize};

use crate::adam::LearningRate;
use crate::curriculum::Curriculum;
use crate::mailbox::MailboxCounts;
use crate::normalization::ValueStatistics;

/// Counters, statistics, curriculum, and random number generator. Fields of earlier versions are ignored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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
    /// Configured initial learning rate that `learning_rate` comes from; `None` in checkpoints of earlier versions.
    #[serde(default)]
    pub initial_rate: Option<f32>,
    /// Random number generator that shuffles the minibatches.
    pub rng: SavedRng,
    /// Task probabilities.
    pub curriculum: Curriculum,
    /// Statistics of node, edge, and global features.
    pub features: FeatureMoments,
    /// Number of scenes in `features`.
    pub n_feature_scenes: u64,
    /// Statistics of the value targets.
    pub values: ValueStatistics,
    /// Number of trajectories by result.
    pub mailbox: MailboxCounts,
    /// Normalization that belongs to the parameters.
    pub normalization: Normalization,
}

/// Largest count, far beyond any run and far from an overflow.
const MAX_COUNT: u64 = 1 << 62;

impl LearnerState {
    /// Checks every number that an update or a policy would use; `model` is the policy's configuration.
    ///
    /// # Errors
    /// Returns the first wrong number under its key in `state.json`.
    pub(crate) fn check(&self, model: &PolicyConfig) -> Result<(), InvalidSetting> {
        for (key, count) in [
            ("version", self.version.0),
            ("n_env_steps", self.n_env_steps),
            ("n_updates", self.n_updates),
            ("n_episodes", self.n_episodes),
        ] {
            let key = format_args!("state.{key}");
            InvalidSetting::check(key, count, count <= MAX_COUNT, format_args!("at most {MAX_COUNT}"))?;
        }
        self.learning_rate.0.check_in("state.learning_rate", &(0.0..))?;
        self.curriculum.check("state.curriculum")?;
        let sizes = model.sizes();
        let widths = [sizes.node, sizes.edge, sizes.global];
        self.features.check("state.features", widths)?;
        self.values.check("state.values")?;
        normalization::check("state.normalization", &self.normalization, widths)
    }

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
        }
    }
}

//! The state of a learner except its network and optimizer, stored in `state.json`.

use policy::PolicyConfig;
use policy::normalization::FeatureMoments;
use proto::{CanonicalSettings, InvalidSetting, Normalization, Weights, WeightsVersion};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::adam::LearningRate;
use crate::curriculum::Curriculum;
use crate::mailbox::MailboxCounts;
use crate::normalization::ValueStatistics;
use crate::numbers::{finite, not_negative, positive};

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
    pub rng: ChaCha8Rng,
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
    #[serde(with = "NormalizationFields")]
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
        not_negative("state.learning_rate", self.learning_rate.0)?;
        self.curriculum.check("state.curriculum")?;
        let sizes = model.sizes();
        let widths = [sizes.node, sizes.edge, sizes.global];
        self.features.check("state.features", widths)?;
        self.values.check("state.values")?;
        check_normalization("state.normalization", &self.normalization, widths)
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

fn check_normalization(path: &str, normalization: &Normalization, widths: [usize; 3]) -> Result<(), InvalidSetting> {
    let Normalization { feature_mean, feature_std, value_mean, value_std } = normalization;
    for (k, width) in widths.into_iter().enumerate() {
        for (key, n) in [("feature_mean", feature_mean[k].len()), ("feature_std", feature_std[k].len())] {
            let fits = n == width || (n == 0 && feature_mean[k].len() == feature_std[k].len());
            InvalidSetting::check(format_args!("{path}.{key}[{k}]"), format_args!("{n} numbers"), fits, width)?;
        }
        feature_mean[k].iter().try_for_each(|mean| finite(&format!("{path}.feature_mean[{k}]"), *mean))?;
        feature_std[k].iter().try_for_each(|std| positive(&format!("{path}.feature_std[{k}]"), *std))?;
    }
    finite(&format!("{path}.value_mean"), *value_mean)?;
    positive(&format!("{path}.value_std"), *value_std)
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

//! Published policies: parameters, normalization statistics, and task probabilities.

use std::collections::BTreeMap;
use std::fmt;

use blueprints::BlueprintId;
use serde::{Deserialize, Serialize};

use crate::CanonicalSettings;

/// Version of published weights, counted from 0 (untrained).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct WeightsVersion(pub u64);

impl fmt::Display for WeightsVersion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// Running statistics frozen with a weights version.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Normalization {
    /// Mean of each node, edge and global feature, in the order of the feature vectors; empty means none.
    pub feature_mean: [Vec<f32>; 3],
    /// Standard deviation of each feature, at least a small floor; same lengths as `feature_mean`.
    pub feature_std: [Vec<f32>; 3],
    /// Mean of the value targets, in reward units.
    pub value_mean: f32,
    /// Standard deviation of the value targets, in reward units, above 0; 1 before there are any targets.
    pub value_std: f32,
}

/// A frozen policy.
#[derive(Clone, Debug, PartialEq)]
pub struct Weights {
    /// The version.
    pub version: WeightsVersion,
    /// Environment steps consumed by the learner.
    pub n_env_steps: u64,
    /// Hash of the network configuration; a process with a different network refuses the weights.
    pub network_hash: u64,
    /// Settings of the policy and the world that the weights are trained with; a process with other ones refuses the
    /// weights. Empty if they are not known, as in policies exported by early versions.
    pub settings: CanonicalSettings,
    /// All parameters as one flat vector, in the order of `policy`'s parameter table.
    pub parameters: Vec<f32>,
    /// Statistics of features and returns.
    pub normalization: Normalization,
    /// Probability of each training blueprint; sums to 1.
    pub task_probabilities: BTreeMap<BlueprintId, f32>,
}

impl Default for Normalization {
    /// Returns no feature statistics, and leaves values unchanged.
    fn default() -> Self {
        Self { feature_mean: Default::default(), feature_std: Default::default(), value_mean: 0.0, value_std: 1.0 }
    }
}

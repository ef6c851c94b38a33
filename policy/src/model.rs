//! A policy in one file, with everything needed to act and nothing that is only needed to learn.
//!
//! The file is a safetensors file with one f32 tensor per parameter, by name. Its metadata has one entry, `lodestone`:
//! JSON with the policy's configuration, the order of the parameters, the normalization, the settings of policy and
//! worlds, a digest of the parameters' names, shapes, and values in their order, and in the best policy of a run the
//! verdict of its evaluation.

mod format;
pub mod tensors;

use burn::tensor::Device;
use proto::codec::MAX_WEIGHTS_BYTES;
use proto::{CanonicalSettings, Normalization, Valid, Weights, WeightsVersion};
use safetensors::SafeTensors;
use serde::{Deserialize, Serialize};
use serde_json::Value;

pub use self::format::{FORMAT_VERSION, FormatVersion, ModelError, parse_policy};
use crate::parameters::{ParameterSpec, digest};
use crate::{Network, PolicyConfig};

/// Name of the metadata entry.
const ENTRY: &str = "lodestone";

/// Maximum size of a file in bytes: the largest network, and names and shapes of its parameters.
pub const MAX_FILE_BYTES: u64 = MAX_WEIGHTS_BYTES as u64 + (4 << 20);

/// A frozen policy.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// The configuration of the policy.
    pub policy: Valid<PolicyConfig>,
    /// The parameters, without task probabilities.
    pub weights: Weights,
    /// How well it did, if it was chosen for that; the evaluator's words.
    pub verdict: Option<Value>,
    /// Names and shapes in the order of the flat parameters.
    pub table: Vec<ParameterSpec>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    format_version: u32,
    weights_version: u64,
    n_env_steps: u64,
    policy: PolicyConfig,
    settings: CanonicalSettings,
    digest: String,
    table: Vec<ParameterSpec>,
    normalization: Normalization,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    verdict: Option<Value>,
}

impl Model {
    /// Creates the model of a policy from weights as they are published, which must be of its network.
    pub fn new(policy: &Valid<PolicyConfig>, weights: &Weights) -> Self {
        let network = Network::init(&policy.network, &policy.sizes(), 0, &Device::flex());
        let weights = Weights { task_probabilities: Default::default(), ..weights.clone() };
        Self { policy: policy.clone(), weights, verdict: None, table: network.table().to_vec() }
    }

    /// Returns the mean of policies that were learned from one another, which often does better than each of them
    /// (Wortsman et al., 2022, *Model soups*). Everything but the parameters is the first one's.
    ///
    /// # Errors
    /// The index of the first policy whose configuration or statistics of features differ.
    ///
    /// # Panics
    /// If there is none.
    pub fn mean(models: &[Self]) -> Result<Self, usize> {
        let first = &models[0];
        let fits = |model: &Self| {
            let [own, others] = [first, model].map(|model| &model.weights.normalization);
            let is_same = own.feature_mean == others.feature_mean && own.feature_std == others.feature_std;
            is_same && model.policy == first.policy && model.table == first.table
        };
        if let Some(odd) = models.iter().position(|model| !fits(model)) {
            return Err(odd);
        }
        let mean = |k: usize| {
            let sum: f64 = models.iter().map(|model| f64::from(model.weights.parameters[k])).sum();
            (sum / models.len() as f64) as f32
        };
        let parameters = (0..first.weights.parameters.len()).map(mean).collect();
        Ok(Self { weights: Weights { parameters, ..first.weights.clone() }, ..first.clone() })
    }

    /// Serializes the model to the file's bytes.
    ///
    /// # Errors
    /// [`ModelError::Mismatch`] if the parameters do not match the table.
    pub fn to_bytes(&self) -> Result<Vec<u8>, ModelError> {
        let header = Header {
            format_version: FORMAT_VERSION,
            weights_version: self.weights.version.0,
            n_env_steps: self.weights.n_env_steps,
            policy: PolicyConfig::clone(&self.policy),
            settings: self.weights.settings.clone(),
            digest: digest(&self.table, &self.weights.parameters),
            table: self.table.clone(),
            normalization: self.weights.normalization.clone(),
            verdict: self.verdict.clone(),
        };
        let header = serde_json::to_string(&header).map_err(|error| ModelError::Mismatch(error.to_string()))?;
        tensors::write(&self.table, &[("", &self.weights.parameters)], Some((ENTRY, header)))
    }

    /// Parses the file's bytes.
    ///
    /// # Errors
    /// All of [`ModelError`] but [`ModelError::Mismatch`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, ModelError> {
        let (_, metadata) = SafeTensors::read_metadata(bytes)
            .map_err(|error| ModelError::Damaged(format!("it is no safetensors file: {error}")))?;
        let header = metadata.metadata().as_ref().and_then(|entries| entries.get(ENTRY));
        let header = header.ok_or_else(|| ModelError::Damaged(format!("its metadata has no entry `{ENTRY}`")))?;
        let malformed = |error: serde_json::Error| ModelError::Damaged(error.to_string());
        let header: Value = serde_json::from_str(header).map_err(malformed)?;
        FormatVersion::deserialize(&header).map_err(malformed)?.check()?;
        // First, because its errors are more helpful.
        let policy = parse_policy(header["policy"].clone())?;
        let header: Header = serde_json::from_value(header).map_err(malformed)?;
        let [parameters] = tensors::read(bytes, &header.table, [""])?;
        tensors::check_digest(&header.table, &parameters, &header.digest)?;
        let weights = Weights {
            version: WeightsVersion(header.weights_version),
            n_env_steps: header.n_env_steps,
            network_hash: policy.hash(),
            settings: header.settings,
            parameters,
            normalization: header.normalization,
            task_probabilities: Default::default(),
        };
        Ok(Self { policy, weights, verdict: header.verdict, table: header.table })
    }
}

//! A policy in one file, with everything needed to act and nothing that is only needed to learn.
//!
//! The file is a safetensors file with one f32 tensor per parameter, by name. Its metadata has one entry, `lodestone`:
//! JSON with the policy's configuration, the order of the parameters, the normalization, the settings of policy and
//! worlds, a digest of the parameters' names, shapes, and values in their order, and in the best policy of a run the
//! verdict of its evaluation.

use std::path::Path;

use blueprints::outside;
use burn::tensor::Device;
use policy::{Network, PolicyConfig};
use proto::codec::MAX_WEIGHTS_BYTES;
use proto::{CanonicalSettings, Normalization, Valid, Weights, WeightsVersion};
use safetensors::SafeTensors;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::checkpoint::{
    Checkpoint, CheckpointError, FORMAT_VERSION, FormatVersion, ParameterInfo, parse_policy, tensors,
};
use crate::state::NormalizationFields;

/// Name of the metadata entry.
const ENTRY: &str = "lodestone";

/// Maximum size of a file in bytes: the largest network, and names and shapes of its parameters.
const MAX_FILE_BYTES: u64 = MAX_WEIGHTS_BYTES as u64 + (4 << 20);

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
    table: Vec<ParameterInfo>,
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
    table: Vec<ParameterInfo>,
    #[serde(with = "NormalizationFields")]
    normalization: Normalization,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    verdict: Option<Value>,
}

impl From<&Checkpoint> for Model {
    fn from(checkpoint: &Checkpoint) -> Self {
        let weights = Weights { task_probabilities: Default::default(), ..checkpoint.weights() };
        Self { policy: checkpoint.model.clone(), weights, verdict: None, table: checkpoint.table.clone() }
    }
}

impl Model {
    /// Creates the model of a policy from weights as they are published, which must be of its network.
    pub fn new(policy: &Valid<PolicyConfig>, weights: &Weights) -> Self {
        let network = Network::init(&policy.network, &policy.sizes(), 0, &Device::flex());
        let table = network.table().iter().map(ParameterInfo::from).collect();
        let weights = Weights { task_probabilities: Default::default(), ..weights.clone() };
        Self { policy: policy.clone(), weights, verdict: None, table }
    }

    /// Serializes the model to the file's bytes.
    ///
    /// # Errors
    /// [`CheckpointError::Mismatch`] if the parameters do not match the table.
    pub fn to_bytes(&self) -> Result<Vec<u8>, CheckpointError> {
        let header = Header {
            format_version: FORMAT_VERSION,
            weights_version: self.weights.version.0,
            n_env_steps: self.weights.n_env_steps,
            policy: PolicyConfig::clone(&self.policy),
            settings: self.weights.settings.clone(),
            digest: tensors::digest(&self.table, &self.weights.parameters),
            table: self.table.clone(),
            normalization: self.weights.normalization.clone(),
            verdict: self.verdict.clone(),
        };
        let header = serde_json::to_string(&header).map_err(|error| CheckpointError::Mismatch(error.to_string()))?;
        tensors::write(&self.table, &[("", &self.weights.parameters)], Some((ENTRY, header)))
    }

    /// Returns names and shapes in the order of the flat parameters.
    pub(crate) fn table(&self) -> &[ParameterInfo] {
        &self.table
    }

    /// Reads a file; one that no policy of a permitted size fills is refused.
    ///
    /// # Errors
    /// [`CheckpointError::Io`], and those of [`Model::from_bytes`].
    pub fn read(path: &Path) -> Result<Self, CheckpointError> {
        let failed = |error| CheckpointError::Io { action: "reading", path: path.into(), error };
        Self::from_bytes(&outside::read(path, MAX_FILE_BYTES).map_err(failed)?, path)
    }

    /// Parses the file's bytes; `path` names the file in errors.
    ///
    /// # Errors
    /// [`CheckpointError::Damaged`] if the bytes are not a model file, and [`CheckpointError::Version`].
    pub fn from_bytes(bytes: &[u8], path: &Path) -> Result<Self, CheckpointError> {
        let damaged = |reason: String| CheckpointError::Damaged { path: path.into(), reason };
        let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(|error| damaged(error.to_string()))?;
        let header = metadata.metadata().as_ref().and_then(|entries| entries.get(ENTRY));
        let header = header.ok_or_else(|| damaged(format!("its metadata has no entry `{ENTRY}`")))?;
        let malformed = |error: serde_json::Error| damaged(error.to_string());
        let header: Value = serde_json::from_str(header).map_err(malformed)?;
        FormatVersion::deserialize(&header).map_err(malformed)?.check(path)?;
        // First, because its errors are more helpful.
        let policy = parse_policy(path, header["policy"].clone())?;
        let header: Header = serde_json::from_value(header).map_err(malformed)?;
        let [parameters] = tensors::read(path, bytes, &header.table, [""])?;
        tensors::check_digest(path, &header.table, &parameters, &header.digest)?;
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

//! The file format of a policy, as written by `lodestone export`.
//!
//! The learner's `Model` reads the same files. It is not used here because the learner depends on the bus, which adds
//! two minutes of compile time.

use policy::PolicyConfig;
use proto::{CanonicalSettings, InvalidSetting, Normalization, Valid, Weights, WeightsVersion};
use safetensors::tensor::Dtype;
use safetensors::{SafeTensorError, SafeTensors};
use serde::Deserialize;

/// The supported format versions.
const FORMAT_VERSION: u32 = 4;

/// Name of the metadata entry.
const ENTRY: &str = "lodestone";

/// Why a file is rejected.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ModelError {
    /// Not a safetensors file, or one with missing tensors.
    #[error("it is no safetensors file")]
    Format(#[from] SafeTensorError),
    /// No policy metadata.
    #[error("its metadata has no entry `{ENTRY}`")]
    NoPolicy,
    /// The metadata entry is invalid.
    #[error("its entry `{ENTRY}` cannot be read")]
    Entry(#[from] serde_json::Error),
    /// Its configuration is invalid.
    #[error(transparent)]
    Config(#[from] InvalidSetting),
    /// The format version is not supported.
    #[error("its format version is {0}, this package reads {FORMAT_VERSION}")]
    Version(u32),
    /// The tensors are not those that were exported.
    #[error("the digest of its tensors is {found} instead of {expected}")]
    Digest { found: String, expected: String },
    /// A tensor does not match the table.
    #[error("tensor {name} is {dtype:?} {shape:?}, its table says F32 {expected:?}")]
    Tensor { name: String, dtype: Dtype, shape: Vec<usize>, expected: Vec<usize> },
}

/// A frozen policy: its configuration and its weights.
#[derive(Debug)]
pub(crate) struct Model {
    pub(crate) config: Valid<PolicyConfig>,
    pub(crate) weights: Weights,
}

/// The part of the entry that every version has.
#[derive(Deserialize)]
struct FormatVersion {
    format_version: u32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    #[serde(rename = "format_version")]
    _format_version: u32,
    weights_version: u64,
    n_env_steps: u64,
    policy: PolicyConfig,
    settings: CanonicalSettings,
    digest: String,
    table: Vec<Parameter>,
    #[serde(with = "Statistics")]
    normalization: Normalization,
    /// Of the best policy of a run.
    #[serde(default, rename = "verdict")]
    _verdict: Option<serde::de::IgnoredAny>,
}

/// Name and shape of a parameter.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Parameter {
    name: String,
    shape: Vec<usize>,
}

/// The serde form of [`Normalization`].
#[derive(Deserialize)]
#[serde(remote = "Normalization", deny_unknown_fields)]
struct Statistics {
    feature_mean: [Vec<f32>; 3],
    feature_std: [Vec<f32>; 3],
    value_mean: f32,
    value_std: f32,
}

impl Model {
    /// Parses the contents of a file.
    ///
    /// # Errors
    /// Returns an error if they are not a policy in a supported format.
    pub(crate) fn read(bytes: &[u8]) -> Result<Self, ModelError> {
        let (_, metadata) = SafeTensors::read_metadata(bytes)?;
        let entry = metadata.metadata().as_ref().and_then(|entries| entries.get(ENTRY)).ok_or(ModelError::NoPolicy)?;
        let FormatVersion { format_version } = serde_json::from_str(entry)?;
        if format_version != FORMAT_VERSION {
            return Err(ModelError::Version(format_version));
        }
        let header: Header = serde_json::from_str(entry)?;
        let tensors = SafeTensors::deserialize(bytes)?;
        let mut parameters = Vec::new();
        for Parameter { name, shape } in &header.table {
            let tensor = tensors.tensor(name)?;
            if tensor.dtype() != Dtype::F32 || tensor.shape() != shape {
                let dtype = tensor.dtype();
                let found = tensor.shape().to_vec();
                let (name, expected) = (name.clone(), shape.clone());
                return Err(ModelError::Tensor { name, dtype, shape: found, expected });
            }
            parameters.extend(tensor.data().as_chunks::<4>().0.iter().map(|x| f32::from_le_bytes(*x)));
        }
        let table = header.table.iter().map(|parameter| (parameter.name.as_str(), parameter.shape.as_slice()));
        let found = policy::parameters::digest(table, &parameters);
        if found != header.digest {
            return Err(ModelError::Digest { found, expected: header.digest });
        }
        let weights = Weights {
            version: WeightsVersion(header.weights_version),
            n_env_steps: header.n_env_steps,
            network_hash: header.policy.hash(),
            settings: header.settings,
            parameters,
            normalization: header.normalization,
            task_probabilities: Default::default(),
        };
        Ok(Self { config: Valid::new(header.policy)?, weights })
    }
}

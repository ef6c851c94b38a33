//! Converts flat vectors to safetensors files with one tensor per parameter, and back.

use std::path::Path;

use policy::parameters::ParameterSpec;
use safetensors::tensor::{Dtype, TensorView};
use safetensors::{SafeTensors, serialize};
use serde::{Deserialize, Serialize};

use super::format::CheckpointError;

/// Name and shape of one parameter.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ParameterInfo {
    /// Name, as in the policy's parameter table.
    pub name: String,
    /// Shape; kernels are `[in, out]`.
    pub shape: Vec<usize>,
}

impl From<&ParameterSpec> for ParameterInfo {
    fn from(spec: &ParameterSpec) -> Self {
        Self { name: spec.name.clone(), shape: spec.shape.clone() }
    }
}

impl ParameterInfo {
    /// Returns the number of entries.
    pub fn n_entries(&self) -> usize {
        self.shape.iter().product()
    }
}

/// Returns the [digest](policy::parameters::digest) of flat parameters in the order of `table`.
pub(crate) fn digest(table: &[ParameterInfo], parameters: &[f32]) -> String {
    let tensors = table.iter().map(|info| (info.name.as_str(), info.shape.as_slice()));
    policy::parameters::digest(tensors, parameters)
}

/// Checks flat parameters against their digest.
pub(crate) fn check_digest(
    path: &Path,
    table: &[ParameterInfo],
    parameters: &[f32],
    expected: &str,
) -> Result<(), CheckpointError> {
    let found = digest(table, parameters);
    if found == expected {
        return Ok(());
    }
    let reason = format!("the digest of its tensors is {found} instead of {expected}");
    Err(CheckpointError::Damaged { path: path.into(), reason })
}

/// Writes flat vectors in the order of `table`, each with its name prefix, and optionally a metadata entry.
pub(crate) fn write(
    table: &[ParameterInfo],
    vectors: &[(&str, &[f32])],
    metadata: Option<(&str, String)>,
) -> Result<Vec<u8>, CheckpointError> {
    let mismatch = |error: safetensors::SafeTensorError| CheckpointError::Mismatch(error.to_string());
    let bytes: Vec<Vec<u8>> =
        vectors.iter().map(|(_, values)| values.iter().flat_map(|x| x.to_le_bytes()).collect()).collect();
    let mut views = Vec::new();
    for ((prefix, _), bytes) in vectors.iter().zip(&bytes) {
        let mut rest = bytes.as_slice();
        for info in table {
            let Some((data, after)) = rest.split_at_checked(4 * info.n_entries()) else {
                return Err(CheckpointError::Mismatch(format!("parameter {} has no values", info.name)));
            };
            rest = after;
            let view = TensorView::new(Dtype::F32, info.shape.clone(), data).map_err(mismatch)?;
            views.push((format!("{prefix}{}", info.name), view));
        }
    }
    let metadata = metadata.map(|(name, text)| [(name.to_owned(), text)].into());
    serialize(views, metadata).map_err(mismatch)
}

/// Reads the flat vectors with the given name prefixes; `path` names the file in errors.
pub(crate) fn read<const N: usize>(
    path: &Path,
    bytes: &[u8],
    table: &[ParameterInfo],
    prefixes: [&str; N],
) -> Result<[Vec<f32>; N], CheckpointError> {
    let broken = |reason: String| CheckpointError::Damaged { path: path.into(), reason };
    let tensors = SafeTensors::deserialize(bytes).map_err(|error| broken(error.to_string()))?;
    let mut vectors = [const { Vec::new() }; N];
    for (prefix, vector) in prefixes.iter().zip(&mut vectors) {
        for info in table {
            let name = format!("{prefix}{}", info.name);
            let tensor = tensors.tensor(&name).map_err(|error| broken(error.to_string()))?;
            if tensor.dtype() != Dtype::F32 || tensor.shape() != info.shape {
                return Err(broken(format!("tensor {name} is {:?} {:?}", tensor.dtype(), tensor.shape())));
            }
            vector.extend(tensor.data().as_chunks::<4>().0.iter().map(|x| f32::from_le_bytes(*x)));
        }
    }
    Ok(vectors)
}

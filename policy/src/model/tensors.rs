//! Converts flat vectors to safetensors files with one tensor per parameter, and back.

use safetensors::tensor::{Dtype, TensorView};
use safetensors::{SafeTensors, serialize};

use super::format::ModelError;
use crate::parameters::{ParameterSpec, digest};

/// Checks flat parameters against their digest.
///
/// # Errors
/// [`ModelError::Damaged`].
pub fn check_digest(table: &[ParameterSpec], parameters: &[f32], expected: &str) -> Result<(), ModelError> {
    let found = digest(table, parameters);
    if found == expected {
        return Ok(());
    }
    Err(ModelError::Damaged(format!("the digest of its tensors is {found} instead of {expected}")))
}

/// Writes flat vectors in the order of `table`, each with its name prefix, and optionally a metadata entry.
///
/// # Errors
/// [`ModelError::Mismatch`] if a vector is too short.
pub fn write(
    table: &[ParameterSpec],
    vectors: &[(&str, &[f32])],
    metadata: Option<(&str, String)>,
) -> Result<Vec<u8>, ModelError> {
    let mismatch = |error: safetensors::SafeTensorError| ModelError::Mismatch(error.to_string());
    let bytes: Vec<Vec<u8>> =
        vectors.iter().map(|(_, values)| values.iter().flat_map(|x| x.to_le_bytes()).collect()).collect();
    let mut views = Vec::new();
    for ((prefix, _), bytes) in vectors.iter().zip(&bytes) {
        let mut rest = bytes.as_slice();
        for spec in table {
            let Some((data, after)) = rest.split_at_checked(4 * spec.n_values()) else {
                return Err(ModelError::Mismatch(format!("parameter {} has no values", spec.name)));
            };
            rest = after;
            let view = TensorView::new(Dtype::F32, spec.shape.clone(), data).map_err(mismatch)?;
            views.push((format!("{prefix}{}", spec.name), view));
        }
    }
    let metadata = metadata.map(|(name, text)| [(name.to_owned(), text)].into());
    serialize(views, metadata).map_err(mismatch)
}

/// Reads the flat vectors with the given name prefixes.
///
/// # Errors
/// [`ModelError::Damaged`] if a tensor is missing or of another type or shape.
pub fn read<const N: usize>(
    bytes: &[u8],
    table: &[ParameterSpec],
    prefixes: [&str; N],
) -> Result<[Vec<f32>; N], ModelError> {
    let broken = |error: safetensors::SafeTensorError| ModelError::Damaged(error.to_string());
    let tensors = SafeTensors::deserialize(bytes).map_err(broken)?;
    let mut vectors = [const { Vec::new() }; N];
    for (prefix, vector) in prefixes.iter().zip(&mut vectors) {
        for spec in table {
            let name = format!("{prefix}{}", spec.name);
            let tensor = tensors.tensor(&name).map_err(broken)?;
            if tensor.dtype() != Dtype::F32 || tensor.shape() != spec.shape {
                let found = format!("tensor {name} is {:?} {:?}", tensor.dtype(), tensor.shape());
                return Err(ModelError::Damaged(found));
            }
            vector.extend(tensor.data().as_chunks::<4>().0.iter().map(|x| f32::from_le_bytes(*x)));
        }
    }
    Ok(vectors)
}

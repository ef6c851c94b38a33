//! Validation rules shared by the decoders. Each returns the checked value or an error that names the field and the
//! invalid value.

use blueprints::{BlockIdx, BlueprintId};

use super::DecodeError;
use crate::CanonicalSettings;

/// Upper limit of coordinates, velocities, and parameters, far above plausible values: sums of products of a few
/// thousand numbers below it stay far below the largest f32, and trained networks have parameters below 100.
pub(super) const LARGEST_MAGNITUDE: f32 = 1e6;

/// Tolerance of a quaternion's norm: far above f32 rounding, far below a visible distortion.
const UNIT_TOLERANCE: f32 = 1e-3;

/// Maximum number of characters of a text quoted in an error, so that no message can flood the log.
const MAX_QUOTED_CHARS: usize = 80;

pub(super) fn invalid(field: &'static str, value: impl ToString, expected: impl std::fmt::Display) -> DecodeError {
    let value: String = value.to_string().chars().take(MAX_QUOTED_CHARS).collect();
    DecodeError::Invalid(format!("{field} is {value}, expected {expected}"))
}

/// Returns an error that shows the value unless `ok`.
pub(super) fn ensure(
    ok: bool,
    field: &'static str,
    value: impl ToString,
    expected: &'static str,
) -> Result<(), DecodeError> {
    if ok { Ok(()) } else { Err(invalid(field, value, expected)) }
}

pub(super) fn present<T>(field: &'static str, value: Option<T>) -> Result<T, DecodeError> {
    value.ok_or(DecodeError::Missing(field))
}

/// Checks that a number is finite and of plausible size.
pub(super) fn number(field: &'static str, value: f32) -> Result<f32, DecodeError> {
    if value.abs() <= LARGEST_MAGNITUDE { Ok(value) } else { Err(invalid(field, value, "a number in −1e6..=1e6")) }
}

pub(super) fn positive(field: &'static str, value: f32) -> Result<f32, DecodeError> {
    if value > 0.0 && value.is_finite() { Ok(value) } else { Err(invalid(field, value, "a finite number above 0")) }
}

/// Checks that there are exactly `N` numbers, finite and of plausible size.
pub(super) fn numbers<const N: usize>(field: &'static str, values: &[f32]) -> Result<[f32; N], DecodeError> {
    let values: [f32; N] = array(field, values)?;
    values.iter().try_for_each(|&v| number(field, v).map(drop))?;
    Ok(values)
}

pub(super) fn array<T: Copy, const N: usize>(field: &'static str, values: &[T]) -> Result<[T; N], DecodeError> {
    values.try_into().map_err(|_| invalid(field, format!("{} values", values.len()), format!("{N} values")))
}

pub(super) fn unit_quaternion(field: &'static str, values: &[f32]) -> Result<[f32; 4], DecodeError> {
    let q: [f32; 4] = numbers(field, values)?;
    let norm = q.iter().map(|x| x * x).sum::<f32>().sqrt();
    let is_unit = (norm - 1.0).abs() <= UNIT_TOLERANCE;
    ensure(is_unit, field, format_args!("a quaternion of norm {norm}"), "a norm within 1e-3 of 1")?;
    Ok(q)
}

pub(super) fn block(field: &'static str, index: u32) -> Result<BlockIdx, DecodeError> {
    let block = u8::try_from(index).ok().and_then(|i| BlockIdx::try_from(i).ok());
    block.ok_or_else(|| invalid(field, index, "a block index in 0..16"))
}

pub(super) fn blueprint_id(field: &'static str, id: String) -> Result<BlueprintId, DecodeError> {
    // The id is cloned so that the error can show it.
    BlueprintId::try_from(id.clone()).map_err(|_| invalid(field, id, "the id of a blueprint"))
}

pub(super) fn settings(text: &str) -> Result<CanonicalSettings, DecodeError> {
    let expected = "lines `key = value`, sorted by key";
    CanonicalSettings::parse(text).map_err(|_| invalid("settings", format!("{} bytes", text.len()), expected))
}

/// Converts an integer to a narrower type.
pub(super) fn narrow<T: TryFrom<u32>>(
    field: &'static str,
    value: u32,
    expected: &'static str,
) -> Result<T, DecodeError> {
    T::try_from(value).map_err(|_| invalid(field, value, expected))
}

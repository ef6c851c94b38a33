//! Checks of numbers in a checkpoint's state.

use proto::InvalidSetting;
use proto::setting::Number;

/// Checks that a number is finite and at least 0.
pub(crate) fn not_negative<T: Number + From<u8>>(key: &str, value: T) -> Result<(), InvalidSetting> {
    InvalidSetting::check(key, value, value.is_finite() && value >= T::from(0), "at least 0 and finite")
}

/// Checks that a number is finite and above 0.
pub(crate) fn positive<T: Number + From<u8>>(key: &str, value: T) -> Result<(), InvalidSetting> {
    InvalidSetting::check(key, value, value.is_finite() && value > T::from(0), "above 0 and finite")
}

pub(crate) fn finite<T: Number>(key: &str, value: T) -> Result<(), InvalidSetting> {
    InvalidSetting::check(key, value, value.is_finite(), "a finite number")
}

/// Checks that a number is in 0..=1, but for the rounding of quotients of small numbers.
pub(crate) fn share(key: &str, value: f64) -> Result<(), InvalidSetting> {
    InvalidSetting::check(key, value, (0.0..=1.001).contains(&value), "0..=1")
}

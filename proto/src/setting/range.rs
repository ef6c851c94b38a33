//! Values with a range, and the error of one outside.

use std::fmt::Display;
use std::ops::{Bound, RangeBounds};

/// A setting outside its range. The message names the key including its sections, the value, and what is valid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct InvalidSetting(String);

impl InvalidSetting {
    /// An error with a message of its own, for rules that need advice.
    pub fn new(message: impl Into<String>) -> Self {
        Self(message.into())
    }

    /// Returns an error that names the key, for example `actor.n_threads`, if `ok` is false. NaN must make `ok` false.
    ///
    /// # Errors
    /// If `ok` is false.
    pub fn check(key: impl Display, value: impl Display, ok: bool, expected: impl Display) -> Result<(), Self> {
        if ok { Ok(()) } else { Err(Self(format!("{key} = {value}: expected {expected}"))) }
    }
}

/// A value with a range: a number, or a collection of numbers that share the range.
pub trait Setting {
    /// The type of the range's bounds.
    type Number: Copy + PartialOrd + Display;

    /// Checks every number in the value.
    ///
    /// # Errors
    /// Returns the first number that is infinite or outside the range.
    fn check_in(&self, key: &str, range: &impl RangeBounds<Self::Number>) -> Result<(), InvalidSetting>;
}

macro_rules! numbers {
    ($($is_finite:expr => $($number:ty),*;)*) => {$($(
        impl Setting for $number {
            type Number = Self;

            fn check_in(&self, key: &str, range: &impl RangeBounds<Self>) -> Result<(), InvalidSetting> {
                let is_finite: fn(Self) -> bool = $is_finite;
                InvalidSetting::check(key, self, range.contains(self) && is_finite(*self), expected(range))
            }
        }
    )*)*};
}

numbers! {
    |_| true => u8, u16, u32, u64, usize, i32;
    f32::is_finite => f32;
    f64::is_finite => f64;
}

macro_rules! collections {
    ($([$($generics:tt)*] $collection:ty;)*) => {$(
        impl<T: Setting, $($generics)*> Setting for $collection {
            type Number = T::Number;

            fn check_in(&self, key: &str, range: &impl RangeBounds<T::Number>) -> Result<(), InvalidSetting> {
                self.iter().try_for_each(|value| value.check_in(key, range))
            }
        }
    )*};
}

collections! {
    [] Option<T>;
    [] Vec<T>;
    [const N: usize] [T; N];
}

/// Returns the range of all numbers above `low`.
pub fn above<T>(low: T) -> (Bound<T>, Bound<T>) {
    (Bound::Excluded(low), Bound::Unbounded)
}

/// Returns the range of all numbers above `low`, up to and including `high`.
pub fn above_to<T>(low: T, high: T) -> (Bound<T>, Bound<T>) {
    (Bound::Excluded(low), Bound::Included(high))
}

/// Describes a range for error messages.
fn expected<T: Display>(range: &impl RangeBounds<T>) -> String {
    let low = match range.start_bound() {
        Bound::Included(low) => format!("at least {low}"),
        Bound::Excluded(low) => format!("above {low}"),
        Bound::Unbounded => "a finite number".to_owned(),
    };
    match (range.start_bound(), range.end_bound()) {
        (Bound::Included(low), Bound::Included(high)) => format!("{low}..={high}"),
        (_, Bound::Included(high)) => format!("{low} and at most {high}"),
        (_, Bound::Excluded(high)) => format!("{low} and below {high}"),
        (Bound::Excluded(_), Bound::Unbounded) => format!("{low} and finite"),
        (_, Bound::Unbounded) => low,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_described_in_words() {
        let ranges = [expected(&above_to(0.0, 1.0)), expected(&(..7)), expected::<u8>(&(..))];
        assert_eq!(ranges, ["above 0 and at most 1", "a finite number and below 7", "a finite number"]);
    }
}

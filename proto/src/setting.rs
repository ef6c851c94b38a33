//! The error of an invalid setting, with the same wording for all configuration sections.

use std::fmt::Display;

/// A setting outside its range.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{key} = {value}: expected {expected}")]
pub struct InvalidSetting {
    /// The key including its sections, for example `actor.n_threads`.
    pub key: String,
    /// The given value.
    pub value: String,
    /// The expected values.
    pub expected: String,
}

impl InvalidSetting {
    /// Checks `ok` and names the key if it is false. A value that is not a number must make `ok` false.
    ///
    /// # Errors
    /// If `ok` is false.
    pub fn check(key: impl Display, value: impl Display, ok: bool, expected: impl Display) -> Result<(), Self> {
        if ok {
            return Ok(());
        }
        Err(Self { key: key.to_string(), value: value.to_string(), expected: expected.to_string() })
    }
}

#[cfg(test)]
mod tests {
    use super::InvalidSetting;

    #[test]
    fn invalid_setting_names_key_value_and_range() {
        assert_eq!(InvalidSetting::check("actor.n_threads", 1, true, "1..=64"), Ok(()));
        let error = InvalidSetting::check("actor.n_threads", 0, false, "1..=64").unwrap_err();
        assert_eq!(error.to_string(), "actor.n_threads = 0: expected 1..=64");
    }
}

//! A setting that cannot be used: one wording for all sections of the configuration.

use std::fmt::Display;

/// A setting outside its range.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{key} = {value}: expected {expected}")]
pub struct InvalidSetting {
    /// The key with its sections, for example `actor.n_threads`.
    pub key: String,
    /// The value that was given.
    pub value: String,
    /// What may be given.
    pub expected: String,
}

impl InvalidSetting {
    /// Turns `ok` into an error that names the key. A value that is not a number must make `ok` false.
    ///
    /// # Errors
    /// When `ok` is false.
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
    fn the_error_names_key_value_and_range() {
        assert_eq!(InvalidSetting::check("actor.n_threads", 1, true, "1..=64"), Ok(()));
        let error = InvalidSetting::check("actor.n_threads", 0, false, "1..=64").unwrap_err();
        assert_eq!(error.to_string(), "actor.n_threads = 0: expected 1..=64");
    }
}

//! Range checks with one form of message.

/// A value of the configuration that is out of range.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("environment.{field} is {value}; it must be {lowest} to {highest}")]
pub struct EnvironmentConfigError {
    /// Dotted path of the field below `environment`.
    pub field: &'static str,
    /// The value found.
    pub value: String,
    /// Lowest valid value.
    pub lowest: f64,
    /// Highest valid value.
    pub highest: f64,
}

pub(super) fn check(field: &'static str, value: f32, lowest: f32, highest: f32) -> Result<(), EnvironmentConfigError> {
    if (lowest..=highest).contains(&value) {
        return Ok(());
    }
    // Through text, so that 0.045 prints as 0.045 and not as its f32 neighbor.
    let exact = |x: f32| x.to_string().parse().unwrap_or(f64::from(x));
    Err(EnvironmentConfigError { field, value: value.to_string(), lowest: exact(lowest), highest: exact(highest) })
}

pub(super) fn check_count(
    field: &'static str,
    value: u32,
    lowest: u32,
    highest: u32,
) -> Result<(), EnvironmentConfigError> {
    if (lowest..=highest).contains(&value) {
        return Ok(());
    }
    Err(EnvironmentConfigError { field, value: value.to_string(), lowest: lowest.into(), highest: highest.into() })
}

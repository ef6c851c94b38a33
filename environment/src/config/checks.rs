//! Range checks with one form of message.

use std::fmt::Display;

use proto::InvalidSetting;

/// Checks that a number lies between two others; `field` is its path below `environment`.
pub(super) fn check<T: PartialOrd + Display>(
    field: &str,
    value: T,
    lowest: T,
    highest: T,
) -> Result<(), InvalidSetting> {
    let ok = (&lowest..=&highest).contains(&&value);
    InvalidSetting::check(format_args!("environment.{field}"), value, ok, format_args!("{lowest}..={highest}"))
}

//! The version of the format of policies and checkpoints, and the errors of reading and writing them.

use proto::Valid;
use serde::Deserialize;
use serde_json::Value;

use crate::PolicyConfig;

/// Format version of checkpoints and policies, incremented when older readers cannot read the files, or when the policy
/// would read other features ([`crate::config::FEATURE_LAYOUT`]).
pub const FORMAT_VERSION: u32 = 4;

/// Errors from writing or reading the bytes of a policy; whoever knows the file puts its name in front.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ModelError {
    /// They differ from what was written; why.
    #[error("is damaged: {0}")]
    Damaged(String),
    /// Another version of the program wrote them.
    #[error(
        "has format version {0}, and this program reads version {FORMAT_VERSION}; use the version of Lodestone that \
         wrote it, or train anew"
    )]
    Version(u32),
    /// The policy has settings that this version does not know, such as another kind of move head; which.
    #[error("holds a policy that this version of Lodestone does not know: {0}")]
    UnknownPolicy(String),
    /// The parameters do not match their table.
    #[error("has parameters that do not match their table: {0}")]
    Mismatch(String),
}

/// The part of a file that every version has.
#[derive(Deserialize)]
pub struct FormatVersion {
    format_version: u32,
}

impl FormatVersion {
    /// Checks that this program reads the version.
    ///
    /// # Errors
    /// [`ModelError::Version`].
    pub fn check(&self) -> Result<(), ModelError> {
        if self.format_version == FORMAT_VERSION { Ok(()) } else { Err(ModelError::Version(self.format_version)) }
    }
}

/// Parses and checks the configuration of a policy.
///
/// # Errors
/// [`ModelError::UnknownPolicy`] if it has unknown settings, and [`ModelError::Damaged`] if one is out of range.
pub fn parse_policy(value: Value) -> Result<Valid<PolicyConfig>, ModelError> {
    let policy: PolicyConfig =
        serde_json::from_value(value).map_err(|error| ModelError::UnknownPolicy(error.to_string()))?;
    Valid::new(policy).map_err(|error| ModelError::Damaged(error.to_string()))
}

//! The version of the checkpoint format, and the errors of reading and writing checkpoints.

use std::path::{Path, PathBuf};

use serde::Deserialize;

/// Format version of checkpoints and policies, incremented when older readers cannot read the files, or when the policy
/// would read other features ([`policy::config::FEATURE_LAYOUT`]).
pub(crate) const FORMAT_VERSION: u32 = 4;

/// Errors from writing or reading a checkpoint.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// The file system returned an error.
    #[error("{action} {path}: {error}")]
    Io {
        /// The failed operation.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        error: std::io::Error,
    },
    /// A file differs from what was written.
    #[error("checkpoint file {path} is damaged: {reason}")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The difference.
        reason: String,
    },
    /// Another version of the program wrote it.
    #[error(
        "{path} has format version {found}, and this program reads version {FORMAT_VERSION}; use the version of \
         Lodestone that wrote it, or train anew"
    )]
    Version {
        /// The file.
        path: PathBuf,
        /// Its format version.
        found: u32,
    },
    /// The policy has settings that this version does not know, such as another kind of move head.
    #[error("{path} holds a policy that this version of Lodestone does not know: {reason}")]
    UnknownPolicy {
        /// The file.
        path: PathBuf,
        /// The unknown setting.
        reason: String,
    },
    /// There is no folder `step-<n>`.
    #[error("there is no checkpoint in {0}")]
    Absent(PathBuf),
    /// The checkpoint belongs to a different network or catalog.
    #[error("the checkpoint does not fit this learner: {0}")]
    Mismatch(String),
}

/// The part of a file that every version has.
#[derive(Deserialize)]
pub(crate) struct FormatVersion {
    format_version: u32,
}

impl FormatVersion {
    /// Checks that this program reads the version of the file at `path`.
    pub(crate) fn check(&self, path: &Path) -> Result<(), CheckpointError> {
        match self.format_version {
            FORMAT_VERSION => Ok(()),
            found => Err(CheckpointError::Version { path: path.into(), found }),
        }
    }
}

/// Returns a closure for `map_err` that names the failed file system operation.
pub(super) fn io(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> CheckpointError {
    move |error| CheckpointError::Io { action, path: path.into(), error }
}

pub(super) fn damaged(folder: &Path, name: &str, reason: impl Into<String>) -> CheckpointError {
    CheckpointError::Damaged { path: folder.join(name), reason: reason.into() }
}

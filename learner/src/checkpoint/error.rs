//! Errors of reading and writing checkpoints.

use std::path::{Path, PathBuf};

use policy::ModelError;
use policy::model::FORMAT_VERSION;

/// Errors from writing or reading a checkpoint.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// The file system returned an error.
    #[error("{0} {1}: {2}")]
    Io(&'static str, PathBuf, std::io::Error),
    /// A file differs from what was written.
    #[error("checkpoint file {0} is damaged: {1}")]
    Damaged(PathBuf, String),
    /// Another version of the program wrote it.
    #[error(
        "{0} has format version {1}, and this program reads version {FORMAT_VERSION}; use the version of Lodestone that \
         wrote it, or train anew"
    )]
    Version(PathBuf, u32),
    /// The policy has settings that this version does not know, such as another kind of move head.
    #[error("{0} holds a policy that this version of Lodestone does not know: {1}")]
    UnknownPolicy(PathBuf, String),
    /// There is no folder `step-<n>`.
    #[error("there is no checkpoint in {0}")]
    Absent(PathBuf),
    /// The checkpoint belongs to a different network or catalog.
    #[error("the checkpoint does not fit this learner: {0}")]
    Mismatch(String),
}

/// Returns a closure for `map_err` that names the failed file system operation.
pub(crate) fn io(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> CheckpointError {
    move |error| CheckpointError::Io(action, path.into(), error)
}

/// Returns a closure for `map_err` that names the file with a policy or its parameters.
pub(crate) fn at(path: &Path) -> impl FnOnce(ModelError) -> CheckpointError {
    let path = path.to_owned();
    move |error| match error {
        ModelError::Damaged(reason) => CheckpointError::Damaged(path, reason),
        ModelError::Version(found) => CheckpointError::Version(path, found),
        ModelError::UnknownPolicy(reason) => CheckpointError::UnknownPolicy(path, reason),
        ModelError::Mismatch(reason) => CheckpointError::Mismatch(reason),
    }
}

pub(super) fn damaged(folder: &Path, name: &str, reason: impl Into<String>) -> CheckpointError {
    CheckpointError::Damaged(folder.join(name), reason.into())
}

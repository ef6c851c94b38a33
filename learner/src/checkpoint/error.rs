//! Errors of reading and writing checkpoints.

use std::path::{Path, PathBuf};

use policy::ModelError;

/// Errors from writing or reading a checkpoint.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// The file system returned an error.
    #[error("{0} {1}: {2}")]
    Io(&'static str, PathBuf, std::io::Error),
    /// A file with a policy, or beside one, cannot be used.
    #[error("{0} {1}")]
    File(PathBuf, ModelError),
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

/// Returns a closure for `map_err` that names the file.
pub(crate) fn at(path: &Path) -> impl FnOnce(ModelError) -> CheckpointError {
    move |error| CheckpointError::File(path.into(), error)
}

pub(super) fn damaged(folder: &Path, name: &str, reason: impl Into<String>) -> CheckpointError {
    CheckpointError::File(folder.join(name), ModelError::Damaged(reason.into()))
}

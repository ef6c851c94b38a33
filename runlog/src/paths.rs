//! Paths of a run's files.

use std::path::{Path, PathBuf};

use proto::Role;

/// The folder of a run, `runs/<run>/`, and its file names. Creating one does not access the disk.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunPaths(PathBuf);

impl RunPaths {
    /// The paths in this folder.
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        Self(folder.into())
    }

    /// The folder itself.
    pub fn folder(&self) -> &Path {
        &self.0
    }

    /// Every setting, as TOML.
    pub fn config(&self) -> PathBuf {
        self.0.join("config.toml")
    }

    /// Version, preset, seed, command and start, as JSON.
    pub fn meta(&self) -> PathBuf {
        self.0.join("meta.json")
    }

    /// Lock file held by the learner of this run.
    pub fn lock(&self) -> PathBuf {
        self.0.join("run.lock")
    }

    /// Folder of the blueprints that the run is given beside those of the catalog, a file each; it is there only if there are
    /// any.
    pub fn blueprints(&self) -> PathBuf {
        self.0.join("blueprints")
    }

    /// Folder of checkpoints.
    pub fn checkpoints(&self) -> PathBuf {
        self.0.join("checkpoints")
    }

    /// One line of JSON per update and per evaluation; see [`MetricsWriter`](crate::MetricsWriter).
    pub fn metrics(&self) -> PathBuf {
        self.0.join("metrics.jsonl")
    }

    /// Folder of a service's event files for TensorBoard, which shows every file below `tb/`.
    pub fn tensorboard(&self, role: Role) -> PathBuf {
        self.0.join("tb").join(role.as_str())
    }

    /// All evaluations; see [`History`](crate::History).
    pub fn history(&self) -> PathBuf {
        self.0.join("eval.db")
    }

    /// Folder of video clips, with a folder for each blueprint in it; see [`ClipStore`](crate::clips::ClipStore).
    pub fn videos(&self) -> PathBuf {
        self.0.join("videos")
    }

    /// Folder of the recordings that clips are made of, organized in the same way.
    pub fn replays(&self) -> PathBuf {
        self.0.join("replays")
    }
}

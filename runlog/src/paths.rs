//! Paths of a run's files.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use proto::Role;

/// Name of the file in `checkpoints/best/`.
pub const BEST_POLICY: &str = "policy.safetensors";

/// The folder of a run, `runs/<run>/`, and its file names. Creating one does not access the disk.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunPaths(PathBuf);

impl RunPaths {
    /// Creates the paths of a run in this folder.
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        Self(folder.into())
    }

    /// Returns the folder of the run.
    pub fn folder(&self) -> &Path {
        &self.0
    }

    /// Returns the file of all settings, as TOML.
    pub fn config(&self) -> PathBuf {
        self.0.join("config.toml")
    }

    /// Returns the file of version, preset, seed, command, and start, as JSON.
    pub fn meta(&self) -> PathBuf {
        self.0.join("meta.json")
    }

    /// Returns the lock file held by the learner of this run.
    pub fn lock(&self) -> PathBuf {
        self.0.join("run.lock")
    }

    /// Returns the folder of the run's blueprints that are not in the catalog, one file each. It exists only if there
    /// are any.
    pub fn blueprints(&self) -> PathBuf {
        self.0.join("blueprints")
    }

    /// Returns the folder of checkpoints.
    pub fn checkpoints(&self) -> PathBuf {
        self.0.join("checkpoints")
    }

    /// Returns the file of the run's best policy so far, in a folder of its own beside the checkpoints.
    pub fn best(&self) -> PathBuf {
        self.checkpoints().join("best").join(BEST_POLICY)
    }

    /// Returns the folder of the [`snapshots`](Self::snapshots).
    pub fn snapshot_folder(&self) -> PathBuf {
        self.0.join("snapshots")
    }

    /// Returns the file of the weights after so many environment steps, kept to show how the run learned.
    pub fn snapshot(&self, n_env_steps: u64) -> PathBuf {
        self.snapshot_folder().join(format!("{n_env_steps}.safetensors"))
    }

    /// Reads from the disk which snapshots there are, by their environment steps.
    pub fn snapshots(&self) -> BTreeMap<u64, PathBuf> {
        let entries = std::fs::read_dir(self.snapshot_folder()).into_iter().flatten().flatten();
        let named = |path: PathBuf| Some((path.file_stem()?.to_str()?.parse().ok()?, path));
        entries.filter_map(|entry| named(entry.path()).filter(|(n, path)| *path == self.snapshot(*n))).collect()
    }

    /// Returns the file with one line of JSON per update and per evaluation; see
    /// [`MetricsWriter`](crate::MetricsWriter).
    pub fn metrics(&self) -> PathBuf {
        self.0.join("metrics.jsonl")
    }

    /// Returns the folder of a service's event files for TensorBoard, which shows every file below `tb/`.
    pub fn tensorboard(&self, role: Role) -> PathBuf {
        self.0.join("tb").join(role.as_str())
    }

    /// Returns the database of all evaluations; see [`History`](crate::History).
    pub fn history(&self) -> PathBuf {
        self.0.join("eval.db")
    }

    /// Returns the folder of videos, with a subfolder for each blueprint; see
    /// [`VideoStore`](crate::videos::VideoStore).
    pub fn videos(&self) -> PathBuf {
        self.0.join("videos")
    }

    /// Returns the folder of the recordings that videos are made from, organized in the same way.
    pub fn replays(&self) -> PathBuf {
        self.0.join("replays")
    }
}

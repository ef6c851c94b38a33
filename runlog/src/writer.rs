//! Metrics of one service on the disk: lines in `metrics.jsonl`, curves for TensorBoard.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::PathBuf;

use proto::Role;
use serde::Serialize;

use crate::RunPaths;
use crate::tensorboard::EventWriter;

/// Writes the metrics of one service; others may write to the same `metrics.jsonl`.
#[derive(Debug)]
pub struct MetricsWriter {
    path: PathBuf,
    tensorboard: EventWriter,
}

/// Why metrics cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The disk refuses.
    #[error("cannot write {}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The metrics are no JSON.
    #[error("metrics are no JSON: {0}")]
    Json(#[from] serde_json::Error),
}

/// Lines for `metrics.jsonl` that are written together.
#[derive(Debug, Default)]
pub struct Lines(Vec<u8>);

/// One line.
#[derive(Serialize)]
struct Line<'a, M> {
    /// Key of the metrics on the bus after `metrics/`.
    key: &'a str,
    #[serde(flatten)]
    metrics: &'a M,
}

impl Lines {
    /// Adds metrics, which are known on the bus as `metrics/<key>`.
    ///
    /// # Errors
    /// When they are no JSON object.
    pub fn push(&mut self, key: &str, metrics: &impl Serialize) -> Result<(), WriteError> {
        self.0.extend(serde_json::to_vec(&Line { key, metrics })?);
        self.0.push(b'\n');
        Ok(())
    }
}

impl MetricsWriter {
    /// Makes the folder and the event file of `role` in it.
    ///
    /// # Errors
    /// When they cannot be made.
    pub fn open(paths: &RunPaths, role: Role) -> Result<Self, WriteError> {
        let folder = paths.tensorboard(role);
        let tensorboard = EventWriter::create(&folder).map_err(|source| WriteError::Io { path: folder, source })?;
        let writer = Self { path: paths.metrics(), tensorboard };
        // Found out now and not after the first hour.
        writer.append(&Lines::default())?;
        Ok(writer)
    }

    /// Appends lines in one write, so that other writers of the file cannot come between.
    ///
    /// # Errors
    /// When the disk refuses; part of the lines may be there then.
    pub fn append(&self, lines: &Lines) -> Result<(), WriteError> {
        let write = || {
            if let Some(folder) = self.path.parent() {
                fs::create_dir_all(folder)?;
            }
            OpenOptions::new().create(true).append(true).open(&self.path)?.write_all(&lines.0)
        };
        write().map_err(|source| WriteError::Io { path: self.path.clone(), source })
    }

    /// Adds a point to the curve of each of these names at a number of environment steps.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn scalars(
        &mut self,
        n_env_steps: u64,
        scalars: impl IntoIterator<Item = (String, f64)>,
    ) -> Result<(), WriteError> {
        let written = self.tensorboard.scalars(n_env_steps, scalars);
        written.map_err(|source| WriteError::Io { path: self.path.with_file_name("tb"), source })
    }
}

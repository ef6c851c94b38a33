//! Writes the metrics of one service: lines of `metrics.jsonl` and TensorBoard curves.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::PathBuf;

use proto::Role;
use serde::Serialize;

use crate::RunPaths;
use crate::tensorboard::EventWriter;

/// Writes the metrics of one service; other services may append to the same `metrics.jsonl`.
#[derive(Debug)]
pub struct MetricsWriter {
    path: PathBuf,
    tensorboard: EventWriter,
}

/// Errors of writing metrics.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// Writing fails.
    #[error("cannot write {}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// The metrics cannot be serialized as JSON.
    #[error("metrics are no JSON: {0}")]
    Json(#[from] serde_json::Error),
}

/// Lines for `metrics.jsonl` that are appended together.
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
    /// Adds metrics that are published on the bus as `metrics/<key>`.
    ///
    /// # Errors
    /// If they are not a JSON object.
    pub fn push(&mut self, key: &str, metrics: &impl Serialize) -> Result<(), WriteError> {
        self.0.extend(serde_json::to_vec(&Line { key, metrics })?);
        self.0.push(b'\n');
        Ok(())
    }
}

impl MetricsWriter {
    /// Creates the folder and the event file of `role` in it.
    ///
    /// # Errors
    /// If they cannot be created.
    pub fn open(paths: &RunPaths, role: Role) -> Result<Self, WriteError> {
        let folder = paths.tensorboard(role);
        let tensorboard = EventWriter::create(&folder).map_err(|source| WriteError::Io { path: folder, source })?;
        let writer = Self { path: paths.metrics(), tensorboard };
        // Detect an error now rather than at the first update.
        writer.append(&Lines::default())?;
        Ok(writer)
    }

    /// Appends lines in one write, so that lines of other writers cannot interleave.
    ///
    /// # Errors
    /// If writing fails; some of the lines may have been written.
    pub fn append(&self, lines: &Lines) -> Result<(), WriteError> {
        let write = || {
            if let Some(folder) = self.path.parent() {
                fs::create_dir_all(folder)?;
            }
            OpenOptions::new().create(true).append(true).open(&self.path)?.write_all(&lines.0)
        };
        write().map_err(|source| WriteError::Io { path: self.path.clone(), source })
    }

    /// Adds a point to each named curve at a number of environment steps.
    ///
    /// # Errors
    /// If writing fails.
    pub fn scalars(
        &mut self,
        n_env_steps: u64,
        scalars: impl IntoIterator<Item = (String, f64)>,
    ) -> Result<(), WriteError> {
        let written = self.tensorboard.scalars(n_env_steps, scalars);
        written.map_err(|source| WriteError::Io { path: self.path.with_file_name("tb"), source })
    }
}

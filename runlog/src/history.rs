//! All evaluations of a run in an SQLite database: `eval.db` in the run's folder.
//!
//! A pass is one transaction over a rollback journal, so a reader sees it whole or not at all, also after the writer was
//! killed in the middle. Not a write-ahead log: that is for many small writes, leaves two more files that a copy must not
//! forget, and does not work on the network file systems of clusters. A pass comes once in minutes.

mod rows;
mod schema;

use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use std::time::Duration;

use proto::WeightsVersion;
use proto::metrics::{EvalBlueprint, EvalReport, EvalResetFree};
use rusqlite::{Connection, OpenFlags};

pub use schema::SCHEMA_VERSION;

/// How long the one who writes waits for those who read, and the other way round.
const PATIENCE: Duration = Duration::from_secs(10);

/// One evaluation of frozen weights, as the history keeps it.
#[derive(Clone, Debug, PartialEq)]
pub struct Pass {
    /// When it ended, milliseconds since 1970.
    pub ended_unix_ms: u64,
    /// How long it took, seconds.
    pub elapsed_s: f64,
    /// Weights that were judged.
    pub weights_version: WeightsVersion,
    /// Environment steps that the learner had consumed for them.
    pub n_env_steps: u64,
    /// Seed of the start states.
    pub seed: u64,
    /// Each blueprint, ordered by split, size and id.
    pub blueprints: Vec<EvalBlueprint>,
    /// Runs without resets, if there were any.
    pub reset_free: Option<EvalResetFree>,
}

impl Pass {
    /// What the history keeps of a report; `ended_unix_ms` in milliseconds since 1970.
    pub fn new(report: &EvalReport, ended_unix_ms: u64) -> Self {
        Self {
            ended_unix_ms,
            elapsed_s: report.summary.elapsed_s,
            weights_version: report.summary.weights_version,
            n_env_steps: report.summary.n_env_steps,
            seed: report.summary.seed,
            blueprints: report.blueprints.clone(),
            reset_free: report.summary.reset_free.clone(),
        }
    }
}

/// Why a history cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum HistoryError {
    /// There is none.
    #[error(
        "there is no history {}: `train` and `evaluator --run-dir` make one with the first evaluation",
        .0.display()
    )]
    Missing(PathBuf),
    /// Made by a later program.
    #[error(
        "the history {} has schema version {found}, this program knows {SCHEMA_VERSION}: use the newer program",
        path.display()
    )]
    Newer {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: i64,
    },
    /// A database with other tables.
    #[error("{} is a database of something else, not a history of evaluations: move it away", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
    },
    /// A second writer.
    #[error("another evaluator writes the history {}: give this one another run directory", .0.display())]
    Taken(PathBuf),
    /// The file that keeps a second writer away cannot be made.
    #[error("cannot lock {}", path.display())]
    Lock {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// SQLite refuses, or the file is damaged.
    #[error("the history {} cannot be used: {source}", path.display())]
    Database {
        /// The file.
        path: PathBuf,
        /// What SQLite says.
        source: rusqlite::Error,
    },
}

/// A history that is open for writing; there is one such at a time.
#[derive(Debug)]
pub struct History {
    path: PathBuf,
    db: Connection,
    /// Locked for as long as it is open. A file beside the database, because closing a second handle of the database itself
    /// would take SQLite's own locks away.
    _lock: File,
}

impl History {
    /// Opens the history at `path` for writing, and makes it and its folder if there is none.
    ///
    /// # Errors
    /// When another writer has it, it is of a newer program or no history, or cannot be written.
    pub fn open(path: &Path) -> Result<Self, HistoryError> {
        let lock = lock(path)?;
        let failed = |source| HistoryError::Database { path: path.to_owned(), source };
        let mut db = Connection::open(path).map_err(failed)?;
        configure(&db).map_err(failed)?;
        schema::prepare(&mut db, path)?;
        Ok(Self { path: path.to_owned(), db, _lock: lock })
    }

    /// Adds a pass; it is on the disk when this returns. Waits up to 10 s for readers.
    ///
    /// # Errors
    /// When it cannot be written; then nothing of it is.
    pub fn append(&mut self, pass: &Pass) -> Result<(), HistoryError> {
        let path = &self.path;
        rows::append(&mut self.db, pass).map_err(|source| HistoryError::Database { path: path.clone(), source })
    }

    /// All passes of the history at `path` in the order in which they were written. A writer may be at work.
    ///
    /// # Errors
    /// When there is none, it is of a newer program or no history, or cannot be read.
    pub fn read(path: &Path) -> Result<Vec<Pass>, HistoryError> {
        if !path.is_file() {
            return Err(HistoryError::Missing(path.to_owned()));
        }
        let failed = |source| HistoryError::Database { path: path.to_owned(), source };
        // Not read-only: a reader may have to undo what a killed writer left half done.
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let db = Connection::open_with_flags(path, flags).map_err(failed)?;
        configure(&db).map_err(failed)?;
        schema::check(&db, path)?;
        rows::read(&db).map_err(failed)
    }
}

fn configure(db: &Connection) -> rusqlite::Result<()> {
    db.busy_timeout(PATIENCE)?;
    db.pragma_update(None, "foreign_keys", true)
}

/// Makes the folder and takes the lock, which the system gives back when the process ends, however it ends.
fn lock(history: &Path) -> Result<File, HistoryError> {
    let mut path = history.as_os_str().to_owned();
    path.push(".lock");
    let path = PathBuf::from(path);
    let failed = |source| HistoryError::Lock { path: path.clone(), source };
    if let Some(folder) = history.parent() {
        std::fs::create_dir_all(folder).map_err(failed)?;
    }
    let file = File::options().create(true).append(true).open(&path).map_err(failed)?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(HistoryError::Taken(history.to_owned())),
        Err(TryLockError::Error(source)) => Err(failed(source)),
    }
}

#[cfg(test)]
pub(crate) mod samples;
#[cfg(test)]
mod tests;

//! The evaluations of a run in an SQLite database, `eval.db` in the run's folder.
//!
//! An evaluation is one transaction with a rollback journal, so a reader sees all of it or nothing, even after the
//! writer was killed. A write-ahead log suits many small writes, but it leaves two more files that a copy must include,
//! and it does not work on the network file systems of clusters. Evaluations are written only every few minutes.

mod rows;
mod schema;

use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use std::time::Duration;

use rusqlite::{Connection, ErrorCode, OpenFlags, TransactionBehavior};

pub use rows::Evaluation;
pub use schema::SCHEMA_VERSION;
use schema::{APPLICATION_ID, TABLES};

/// Time that a writer waits for readers, and readers for a writer.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);

/// Errors of the history.
#[derive(Debug, thiserror::Error)]
pub enum HistoryError {
    /// The file does not exist.
    #[error(
        "there is no history {}: `train` and `evaluator --run-dir` make one with the first evaluation",
        .0.display()
    )]
    Missing(PathBuf),
    /// A newer version of the program wrote the file, with this schema version.
    #[error("the history {0} has schema version {1}, this program knows {SCHEMA_VERSION}: use the newer program")]
    Newer(PathBuf, i64),
    /// The file is a database with other tables.
    #[error("{} is a database of something else, not a history of evaluations: move it away", .0.display())]
    Foreign(PathBuf),
    /// Another writer has the file open.
    #[error("another evaluator writes the history {}: give this one another run directory", .0.display())]
    Taken(PathBuf),
    /// The lock file cannot be created.
    #[error("cannot lock {0}")]
    Lock(PathBuf, #[source] std::io::Error),
    /// SQLite returned an error, or the file is damaged.
    #[error("the history {0} cannot be used: {1}; {advice}", advice = advice(.1))]
    Database(PathBuf, rusqlite::Error),
}

/// Returns what to do about an error of SQLite.
fn advice(error: &rusqlite::Error) -> &'static str {
    match error.sqlite_error_code() {
        Some(ErrorCode::NotADatabase | ErrorCode::DatabaseCorrupt) => "move it away to begin a new one",
        Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => "close the other programs that use it",
        Some(ErrorCode::DiskFull) => "make room on its disk",
        _ => "check that it can be written, and that this program made it",
    }
}

/// A history open for writing; there is at most one writer at a time.
#[derive(Debug)]
pub struct History {
    path: PathBuf,
    db: Connection,
    /// Locked while the history is open. It is a separate file, because closing a second handle of the database itself
    /// would release SQLite's own locks.
    _lock: File,
}

impl History {
    /// Opens the history at `path` for writing, and creates it and its folder if needed.
    ///
    /// # Errors
    /// If another writer has it open, it has a newer version or is not a history, or it cannot be written.
    pub fn open(path: &Path) -> Result<Self, HistoryError> {
        let lock = lock(path)?;
        let failed = |error| HistoryError::Database(path.to_owned(), error);
        let mut db = Connection::open(path).map_err(failed)?;
        configure(&db).map_err(failed)?;
        prepare(&mut db).map_err(failed)?;
        check(&db, path)?;
        Ok(Self { path: path.to_owned(), db, _lock: lock })
    }

    /// Appends an evaluation; it is on disk when this returns. Waits up to 10 s for readers.
    ///
    /// # Errors
    /// If it cannot be written; the history then stays unchanged.
    pub fn append(&mut self, evaluation: &Evaluation) -> Result<(), HistoryError> {
        let path = &self.path;
        rows::append(&mut self.db, evaluation).map_err(|error| HistoryError::Database(path.clone(), error))
    }

    /// Reads all evaluations of the history at `path` in writing order, even while a writer has it open.
    ///
    /// # Errors
    /// If it does not exist, has a newer version, is not a history, or cannot be read.
    pub fn read(path: &Path) -> Result<Vec<Evaluation>, HistoryError> {
        if !path.is_file() {
            return Err(HistoryError::Missing(path.to_owned()));
        }
        let failed = |error| HistoryError::Database(path.to_owned(), error);
        // Not read-only: a reader may have to roll back a transaction of a killed writer.
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let db = Connection::open_with_flags(path, flags).map_err(failed)?;
        configure(&db).map_err(failed)?;
        check(&db, path)?;
        rows::read(&db).map_err(failed)
    }
}

fn configure(db: &Connection) -> rusqlite::Result<()> {
    db.busy_timeout(BUSY_TIMEOUT)?;
    db.pragma_update(None, "foreign_keys", true)
}

/// Creates the tables in an empty database; leaves any other unchanged.
fn prepare(db: &mut Connection) -> rusqlite::Result<()> {
    // Check and create under one lock: if two processes find it empty, the second sees the tables of the first.
    let transaction = db.transaction_with_behavior(TransactionBehavior::Immediate)?;
    let n_tables: i64 = transaction.query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get(0))?;
    if n_tables == 0 {
        transaction.execute_batch(TABLES)?;
        transaction.pragma_update(None, "application_id", APPLICATION_ID)?;
        transaction.pragma_update(None, "user_version", SCHEMA_VERSION)?;
    }
    transaction.commit()
}

/// Checks that the database is a history of this version.
fn check(db: &Connection, path: &Path) -> Result<(), HistoryError> {
    let pragma = |name: &str| db.pragma_query_value(None, name, |row| row.get::<_, i64>(0));
    let failed = |error| HistoryError::Database(path.to_owned(), error);
    let path = path.to_owned();
    match (pragma("application_id").map_err(failed)?, pragma("user_version").map_err(failed)?) {
        (APPLICATION_ID, SCHEMA_VERSION) => Ok(()),
        (APPLICATION_ID, found) if found > SCHEMA_VERSION => Err(HistoryError::Newer(path, found)),
        // Version 1 has no predecessor; later versions migrate older tables here.
        _ => Err(HistoryError::Foreign(path)),
    }
}

/// Creates the folder and acquires the lock. The system releases the lock when the process ends, however it ends.
fn lock(history: &Path) -> Result<File, HistoryError> {
    let mut path = history.as_os_str().to_owned();
    path.push(".lock");
    let path = PathBuf::from(path);
    let failed = |error| HistoryError::Lock(path.clone(), error);
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
pub(crate) mod tests;

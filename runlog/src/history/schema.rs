//! The tables of the history and their versions.

use std::path::Path;

use rusqlite::{Connection, TransactionBehavior};

use super::HistoryError;

/// Version of the tables that this program writes, stored in SQLite's `user_version`.
pub const SCHEMA_VERSION: i64 = 1;

/// "lode" in ASCII, stored in SQLite's `application_id`; it distinguishes a history from other databases.
const APPLICATION_ID: i64 = 0x6c6f_6465;

/// Version 1. A return that is not a number is null, because SQLite cannot store NaN.
const TABLES: &str = "
CREATE TABLE pass (
    pass_id         INTEGER PRIMARY KEY,
    ended_unix_ms   INTEGER NOT NULL,
    elapsed_s       REAL NOT NULL,
    weights_version INTEGER NOT NULL,
    n_env_steps     INTEGER NOT NULL,
    seed            INTEGER NOT NULL
) STRICT;
CREATE TABLE blueprint (
    blueprint_id INTEGER PRIMARY KEY,
    name         TEXT NOT NULL,
    split        TEXT NOT NULL,
    n_blocks     INTEGER NOT NULL,
    UNIQUE (name, split, n_blocks)
) STRICT;
CREATE TABLE outcome (
    pass_id               INTEGER NOT NULL REFERENCES pass,
    blueprint_id          INTEGER NOT NULL REFERENCES blueprint,
    acting                TEXT NOT NULL CHECK (acting IN ('mode', 'sampled')),
    n_episodes            INTEGER NOT NULL,
    n_successes           INTEGER NOT NULL,
    n_stable_successes    INTEGER NOT NULL,
    n_diverged            INTEGER NOT NULL,
    mean_steps            REAL NOT NULL,
    mean_steps_to_success REAL,
    return_connected      REAL,
    return_wrong          REAL,
    return_magnets        REAL,
    return_blocks         REAL,
    return_force          REAL,
    PRIMARY KEY (pass_id, blueprint_id, acting)
) STRICT, WITHOUT ROWID;
CREATE TABLE reset_free (
    pass_id               INTEGER NOT NULL REFERENCES pass,
    acting                TEXT NOT NULL CHECK (acting IN ('mode', 'sampled')),
    n_runs                INTEGER NOT NULL,
    n_goals               INTEGER NOT NULL,
    n_episodes            INTEGER NOT NULL,
    n_successes           INTEGER NOT NULL,
    n_stable_successes    INTEGER NOT NULL,
    n_diverged            INTEGER NOT NULL,
    mean_steps            REAL NOT NULL,
    mean_steps_to_success REAL,
    return_connected      REAL,
    return_wrong          REAL,
    return_magnets        REAL,
    return_blocks         REAL,
    return_force          REAL,
    n_successes_by_goal   TEXT NOT NULL,
    run_rate_std          REAL NOT NULL,
    n_forced_resets       INTEGER NOT NULL,
    PRIMARY KEY (pass_id, acting)
) STRICT, WITHOUT ROWID;
";

/// Creates the tables in an empty database; leaves a database of this version unchanged.
///
/// # Errors
/// If the database has a newer version, is not a history, or cannot be written.
pub(super) fn prepare(db: &mut Connection, path: &Path) -> Result<(), HistoryError> {
    let failed = |error| HistoryError::Database { path: path.to_owned(), error };
    // Check and create under one lock: if two processes find it empty, the second sees the tables of the first.
    let transaction = db.transaction_with_behavior(TransactionBehavior::Immediate).map_err(failed)?;
    let n_tables: i64 =
        transaction.query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get(0)).map_err(failed)?;
    if n_tables == 0 {
        transaction.execute_batch(TABLES).map_err(failed)?;
        transaction.pragma_update(None, "application_id", APPLICATION_ID).map_err(failed)?;
        transaction.pragma_update(None, "user_version", SCHEMA_VERSION).map_err(failed)?;
    }
    transaction.commit().map_err(failed)?;
    check(db, path)
}

/// Checks that the database is a history of this version.
///
/// # Errors
/// If it has a newer version, is not a history, or cannot be read.
pub(super) fn check(db: &Connection, path: &Path) -> Result<(), HistoryError> {
    let pragma = |name: &str| db.pragma_query_value(None, name, |row| row.get::<_, i64>(0));
    let failed = |error| HistoryError::Database { path: path.to_owned(), error };
    let path = path.to_owned();
    match (pragma("application_id").map_err(failed)?, pragma("user_version").map_err(failed)?) {
        (APPLICATION_ID, SCHEMA_VERSION) => Ok(()),
        (APPLICATION_ID, found) if found > SCHEMA_VERSION => Err(HistoryError::Newer { path, found }),
        // Version 1 has no predecessor; later versions migrate older tables here.
        _ => Err(HistoryError::Foreign { path }),
    }
}

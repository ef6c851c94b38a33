//! The tables of the history and their version.

/// Version of the tables that this program writes, stored in SQLite's `user_version`.
pub const SCHEMA_VERSION: i64 = 1;

/// "lode" in ASCII, stored in SQLite's `application_id`; it distinguishes a history from other databases.
pub(super) const APPLICATION_ID: i64 = 0x6c6f_6465;

/// Version 1. A return that is not a number is null, because SQLite cannot store NaN.
pub(super) const TABLES: &str = "
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

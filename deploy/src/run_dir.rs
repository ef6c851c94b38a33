//! The folder that a run leaves behind.

use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use serde::Serialize;

use crate::cli::RunArgs;
use crate::config::Config;
use crate::exit::Failure;

/// Name of the file with every setting.
pub const CONFIG_FILE: &str = "config.toml";

/// Name of the file that the process which learns in the folder locks.
const LOCK_FILE: &str = "run.lock";

/// A run's folder, which exists and in which no other process learns until this is dropped.
#[derive(Debug)]
pub struct RunDir {
    path: PathBuf,
    /// The system gives the lock back when the process ends, however it ends.
    _lock: File,
}

/// Where a run begins.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Origin {
    /// The folder whose configuration is used, if it is that of an earlier start.
    pub config: Option<PathBuf>,
    /// The folder whose checkpoints are used, if any.
    pub checkpoint: Option<PathBuf>,
}

impl Origin {
    /// The run to continue, if it is named, or is there already and may be continued.
    pub fn find(args: &RunArgs) -> Self {
        if let Some(resume) = &args.resume {
            return Self { config: Some(resume.clone()), checkpoint: Some(resume.clone()) };
        }
        let Some(folder) = args.run_dir.as_ref().filter(|folder| args.auto_resume && folder.join(CONFIG_FILE).exists())
        else {
            return Self::default();
        };
        // One that was ended before its first checkpoint begins again.
        let has_checkpoint = learner::checkpoint::exists(&folder.join(learner::run::CHECKPOINTS));
        Self { config: Some(folder.clone()), checkpoint: has_checkpoint.then(|| folder.clone()) }
    }
}

/// What produced a run, beside its configuration.
#[derive(Debug, Serialize)]
struct Meta<'a> {
    lodestone_version: &'static str,
    command: Vec<String>,
    started_utc: String,
    seed: u64,
    resumed_from: Option<&'a Path>,
}

impl RunDir {
    /// Makes the folder, `runs/<date>-<name>` unless a path is given, takes its lock and writes `config.toml` and `meta.json` into
    /// it.
    ///
    /// # Errors
    /// When the folder holds another run than `origin`, a process learns in it, or it cannot be written. Nothing has been
    /// changed then.
    pub fn create(path: Option<&Path>, config: &Config, origin: &Origin) -> Result<Self, Failure> {
        let started = utc(SystemTime::now());
        let stamp = started.replace(':', "");
        let path = path
            .or(origin.config.as_deref())
            .map_or_else(|| Path::new("runs").join(format!("{stamp}-{}", config.bus.run)), Path::to_owned);
        let shown = path.display();
        let failed = |error| Failure::Checkpoint(anyhow::Error::new(error).context(format!("writing to {shown}")));
        fs::create_dir_all(&path).map_err(failed)?;
        let lock = File::create(path.join(LOCK_FILE)).map_err(failed)?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                return Err(Failure::Usage(format!(
                    "another process learns in {shown}: end it first, or choose another `--run-dir`"
                )));
            }
            Err(TryLockError::Error(error)) => return Err(failed(error)),
        }
        // Looked at under the lock, so that of two processes that start at once only one finds the folder empty.
        if path.join(CONFIG_FILE).exists() && origin.config.as_ref() != Some(&path) {
            return Err(Failure::Usage(format!(
                "{shown} holds a run already: continue it with `--resume {shown}` or choose another `--run-dir`"
            )));
        }
        let meta = Meta {
            lodestone_version: env!("CARGO_PKG_VERSION"),
            command: std::env::args().collect(),
            started_utc: started,
            seed: config.seed,
            resumed_from: origin.checkpoint.as_deref(),
        };
        let meta = serde_json::to_string_pretty(&meta).expect("plain strings and numbers are JSON");
        fs::write(path.join(CONFIG_FILE), config.to_toml()).map_err(failed)?;
        fs::write(path.join("meta.json"), meta + "\n").map_err(failed)?;
        Ok(Self { path, _lock: lock })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// `2026-01-31T08:05` of a time after 1970, in UTC.
fn utc(time: SystemTime) -> String {
    let seconds = time.duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    let (year, month, day) = civil_date(seconds / 86_400);
    format!("{year:04}-{month:02}-{day:02}T{:02}:{:02}", seconds / 3600 % 24, seconds / 60 % 60)
}

/// The Gregorian date of a number of days after 1970-01-01.
///
/// Howard Hinnant's `civil_from_days`: years begin in March, so that the leap day is the last of a year.
fn civil_date(days_since_1970: u64) -> (u64, u64, u64) {
    let days = days_since_1970 + 719_468;
    let (era, day_of_era) = (days / 146_097, days % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let march_month = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * march_month + 2) / 5 + 1;
    let month = if march_month < 10 { march_month + 3 } else { march_month - 9 };
    (era * 400 + year_of_era + u64::from(month <= 2), month, day)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn dates_are_those_of_the_calendar() {
        for (seconds, expected) in [
            (0, "1970-01-01T00:00"),
            (951_782_399, "2000-02-28T23:59"),
            (951_782_400, "2000-02-29T00:00"),
            (951_868_800, "2000-03-01T00:00"),
            (1_767_225_599, "2025-12-31T23:59"),
            (1_767_225_600, "2026-01-01T00:00"),
        ] {
            assert_eq!(utc(UNIX_EPOCH + Duration::from_secs(seconds)), expected);
        }
    }
}

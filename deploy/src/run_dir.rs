//! The folder of a run.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use blueprints::catalog::is_hidden;
use blueprints::outside;
use bus::BusConfig;
use runlog::RunPaths;
use serde::Serialize;
use serde_json::Value;
use time::OffsetDateTime;

use crate::cli::RunArgs;
use crate::config::{Config, Preset, nearest, suggestion_or};
use crate::exit::Failure;
use crate::replace::{PLAIN, SECRET, replace};
use crate::shell;

/// The existing folder of a run; no other process learns in it until this is dropped.
#[derive(Debug)]
pub(crate) struct RunDir {
    pub(crate) paths: RunPaths,
    is_new: bool,
    /// The operating system releases the lock when the process ends, for whatever reason.
    _lock: File,
}

/// Maximum size of `meta.json` in bytes; a command line has at most two million.
const MAX_META_BYTES: u64 = 16 << 20;

/// Where a run starts from.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Origin {
    /// The folder whose configuration is used, if the run was started before.
    pub(crate) config: Option<PathBuf>,
    /// The folder whose checkpoints are used, if any.
    pub(crate) checkpoint: Option<PathBuf>,
}

impl Origin {
    /// Finds the run to continue: the one named with `--resume`, or an existing one with `--auto-resume`.
    pub(crate) fn find(args: &RunArgs) -> Self {
        let is_there = |folder: &&PathBuf| args.auto_resume && RunPaths::new(*folder).config().exists();
        let Some(folder) = args.resume.as_ref().or_else(|| args.run_dir.as_ref().filter(is_there)) else {
            return Self::default();
        };
        // A run without a checkpoint starts over. The learner reports any other problem.
        let paths = RunPaths::new(folder);
        let continues = learner::checkpoint::exists(&paths.checkpoints()) || !paths.config().exists();
        Self { config: Some(folder.clone()), checkpoint: continues.then(|| folder.clone()) }
    }
}

/// Whether the folder holds more than what a run writes before its services start. A history alone comes from an
/// evaluator that started before the learner.
fn has_begun(paths: &RunPaths) -> bool {
    let has_metrics = fs::metadata(paths.metrics()).is_ok_and(|file| file.len() > 0);
    let has_learned = has_metrics || learner::checkpoint::exists(&paths.checkpoints());
    has_learned || (paths.config().exists() && paths.history().exists())
}

/// What produced a run, in addition to its configuration.
#[derive(Debug, Serialize)]
struct Meta<'a> {
    lodestone_version: &'static str,
    command: Vec<String>,
    started_utc: String,
    preset: Option<&'a str>,
    seed: u64,
    commit: Option<String>,
    resumed_from: Option<String>,
}

/// The commit that the program's build named, or else that of the checkout that it lies in. Its log is read without git:
/// a child could hold the lock of a run for a moment.
fn commit() -> Option<String> {
    let checkout = Path::new(env!("CARGO_MANIFEST_DIR")).parent()?;
    let logged = || {
        std::env::current_exe().ok().filter(|program| program.starts_with(checkout))?;
        let log = fs::read_to_string(checkout.join(".git/logs/HEAD")).ok()?;
        Some(log.lines().last()?.split(' ').nth(1)?.get(..12)?.to_owned())
    };
    option_env!("BUILD_COMMIT").map(str::to_owned).or_else(logged)
}

fn meta_of(paths: &RunPaths) -> Option<serde_json::Map<String, Value>> {
    serde_json::from_slice(&outside::read(&paths.meta(), MAX_META_BYTES).ok()?).ok()
}

/// The preset that a run was started with, if it is recorded. Earlier versions did not record it.
pub(crate) fn preset_of(paths: &RunPaths) -> Option<String> {
    Some(meta_of(paths)?.get("preset")?.as_str()?.to_owned())
}

/// What produced a run, for those who see its page: what is recorded, without the page's token, and the settings.
pub(crate) fn origin_of(paths: Option<&RunPaths>, config: &Config) -> Value {
    let mut origin = paths.and_then(meta_of).unwrap_or_default();
    for word in origin.get_mut("command").and_then(Value::as_array_mut).into_iter().flatten() {
        if let Some((name, _)) = word.as_str().and_then(|text| text.split_once("token")) {
            *word = format!("{name}token=…").into();
        }
    }
    origin.insert("settings".to_owned(), config.shown());
    origin.into()
}

/// Checks that a run, a checkpoint, or a recording exists.
///
/// # Errors
/// [`Failure::NothingToShow`] with the path that is most like the given one where the two part.
pub(crate) fn check_exists(path: &Path) -> Result<(), Failure> {
    if path.exists() {
        return Ok(());
    }
    let here = |folder: &Path| if folder == Path::new("") { PathBuf::from(".") } else { folder.to_owned() };
    // The first name that a folder lacks.
    let lacks = |missing: &&Path| missing.parent().is_some_and(|folder| here(folder).is_dir());
    let alike = path.ancestors().find(lacks).and_then(|missing| {
        let folder = missing.parent()?;
        let name = missing.file_name()?.to_string_lossy();
        let entries = fs::read_dir(here(folder)).into_iter().flatten().flatten();
        let names: Vec<String> = entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
        let listed = names.iter().map(String::as_str).filter(|name| !name.starts_with('.'));
        Some(folder.join(nearest(&name, listed)?).display().to_string())
    });
    Err(Failure::NothingToShow(format!("{} does not exist{}", path.display(), suggestion_or(&alike, ""))))
}

/// Checks that a folder is that of a run.
///
/// # Errors
/// That it does not exist, or has no configuration; then with the runs in it.
pub(crate) fn check_run(folder: &Path) -> Result<(), Failure> {
    check_exists(folder)?;
    if RunPaths::new(folder).config().exists() {
        return Ok(());
    }
    let shown = folder.display();
    let runs = runs_in(folder);
    Err(Failure::NothingToShow(format!("{shown} is no folder of a run: it has no config.toml{runs}")))
}

/// What to add to a message about a folder that is not a run's: the newest runs in it, or nothing.
pub(crate) fn runs_in(folder: &Path) -> String {
    /// More names would hide the message.
    const N_NAMED: usize = 3;
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut runs: Vec<(SystemTime, PathBuf)> = entries
        .filter(|entry| !is_hidden(&entry.file_name()))
        .filter_map(|entry| {
            let path = entry.path();
            let begun = fs::metadata(RunPaths::new(&path).config()).and_then(|config| config.modified());
            Some((begun.ok()?, path))
        })
        .collect();
    runs.sort_by(|a, b| b.cmp(a));
    if runs.is_empty() {
        return String::new();
    }
    let named: Vec<String> = runs.iter().take(N_NAMED).map(|(_, path)| path.display().to_string()).collect();
    let more = if runs.len() > N_NAMED { format!(" and {} more", runs.len() - N_NAMED) } else { String::new() };
    format!("; the newest runs in it: {}{more}", named.join(", "))
}

/// Creates the default folder of a run, `runs/<date>-<name>`, with a number appended if one exists for this minute.
fn default_folder(config: &Config) -> Result<PathBuf, Failure> {
    let stamp = utc(SystemTime::now()).replace(':', "");
    make_new(Path::new("runs"), &format!("{stamp}-{}", config.bus.run))
        .map_err(|error| Failure::Checkpoint(anyhow::Error::new(error).context("making a folder in runs")))
}

/// Creates `name` in `folder`, or `name-2`, `name-3`, and so on if it exists.
fn make_new(folder: &Path, name: &str) -> io::Result<PathBuf> {
    fs::create_dir_all(folder)?;
    let mut path = folder.join(name);
    let mut n = 1;
    // Creating the folder is the test, so that two processes started in the same minute never get the same one.
    while let Err(error) = fs::create_dir(&path) {
        if error.kind() != io::ErrorKind::AlreadyExists {
            return Err(error);
        }
        n += 1;
        path = folder.join(format!("{name}-{n}"));
    }
    Ok(path)
}

impl RunDir {
    /// Creates the folder, `runs/<date>-<name>` unless a path is given, and takes its lock.
    ///
    /// # Errors
    /// When the folder holds a run other than `origin` that has started learning, another process learns in it, or it
    /// cannot be written. Existing files are then unchanged.
    pub(crate) fn claim(path: Option<&Path>, config: &Config, origin: &Origin) -> Result<Self, Failure> {
        let path =
            path.or(origin.config.as_deref()).map_or_else(|| default_folder(config), |path| Ok(path.to_owned()))?;
        let paths = RunPaths::new(&path);
        let shown = path.display();
        let failed = unwritable(&path);
        fs::create_dir_all(&path).map_err(&failed)?;
        let lock = File::create(paths.lock()).map_err(&failed)?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                return Err(Failure::Usage(format!(
                    "another process learns in {shown}: end it first, or choose another `--run-dir`"
                )));
            }
            Err(TryLockError::Error(error)) => return Err(failed(error)),
        }
        // Checked under the lock, so that only one of two processes that start at once finds the folder empty.
        let is_new = !paths.config().exists();
        if has_begun(&paths) && origin.config.as_ref() != Some(&path) {
            return Err(Failure::Usage(format!(
                "{shown} holds a run already: choose another `--run-dir`, or continue it: `train --resume {}`, and `--auto-resume` for a learner",
                shell::path(&path)
            )));
        }
        Ok(Self { paths, is_new, _lock: lock })
    }

    /// Writes `config.toml` and `meta.json`; other processes may be reading them. A resumed run keeps the `preset` that
    /// it was started with.
    pub(crate) fn describe(&self, config: &Config, preset: Option<&Preset>, origin: &Origin) -> Result<(), Failure> {
        let before = origin.config.as_ref().and_then(|folder| preset_of(&RunPaths::new(folder)));
        let preset = preset.map(|preset| preset.name.to_owned()).or(before);
        let meta = Meta {
            lodestone_version: env!("CARGO_PKG_VERSION"),
            // Without the flag by which a sweep ends its trainings: by hand, it would end them at once.
            command: std::env::args_os()
                .map(|argument| argument.to_string_lossy().into_owned())
                .filter(|argument| argument != "--end-with-stdin")
                .collect(),
            started_utc: utc(SystemTime::now()),
            preset: preset.as_deref(),
            seed: config.seed,
            commit: commit(),
            resumed_from: origin.checkpoint.as_deref().map(|path| path.display().to_string()),
        };
        let meta = serde_json::to_string_pretty(&meta).expect("plain strings and numbers are JSON");
        // The configuration holds the page's token, and the command may.
        let has_token = config.dashboard.web.as_ref().is_some_and(|web| web.token.is_some());
        let mode = if has_token { SECRET } else { PLAIN };
        replace(&self.paths.config(), config.to_toml().as_bytes(), mode)
            .and_then(|()| replace(&self.paths.meta(), (meta + "\n").as_bytes(), mode))
            .map_err(unwritable(self.path()))
    }

    /// Removes what was written for a new run that could not start.
    pub(crate) fn abandon(&self) {
        if self.is_new {
            let socket = BusConfig::socket(self.path());
            let its_lock = socket.with_extension("sock.lock");
            let files = [self.paths.config(), self.paths.meta(), self.paths.lock(), socket, its_lock];
            let remove = |file| match fs::remove_file(file) {
                // The folder was claimed but not described yet.
                Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
                removed => removed,
            };
            let removed = files.iter().try_for_each(remove);
            // A folder with other content stays.
            if let Err(error) = removed.and_then(|()| fs::remove_dir(self.path())) {
                tracing::debug!(%error, "the folder of the run stays");
            }
        }
    }

    pub(crate) fn path(&self) -> &Path {
        self.paths.folder()
    }
}

/// For `map_err`: adds the name of the folder.
fn unwritable(folder: &Path) -> impl Fn(io::Error) -> Failure {
    move |error| Failure::Checkpoint(anyhow::Error::new(error).context(format!("writing to {}", folder.display())))
}

/// Formats a time after 1970 in UTC, for example `2026-01-31T08:05`.
fn utc(time: SystemTime) -> String {
    let time = OffsetDateTime::from(time);
    format!("{}T{:02}:{:02}", time.date(), time.hour(), time.minute())
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;
    use std::time::{Duration, UNIX_EPOCH};

    use dashboard::DashboardConfig;
    use dashboard::config::WebConfig;

    use super::*;

    fn start(path: &Path, origin: &Origin) -> Result<RunDir, Failure> {
        begin(path, &Config::default(), None, origin)
    }

    fn begin(path: &Path, config: &Config, preset: Option<&Preset>, origin: &Origin) -> Result<RunDir, Failure> {
        let claimed = RunDir::claim(Some(path), config, origin)?;
        claimed.describe(config, preset, origin)?;
        Ok(claimed)
    }

    #[test]
    fn runs_of_one_minute_have_folders_of_their_own() {
        let folder = tempfile::tempdir().unwrap();
        for expected in ["run", "run-2", "run-3"] {
            assert_eq!(make_new(folder.path(), "run").unwrap(), folder.path().join(expected));
        }
    }

    #[test]
    fn a_start_that_failed_can_be_made_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run");
        start(&path, &Origin::default()).unwrap().abandon();
        assert!(!path.exists());
        // Not abandoned, as after a kill: the run can be started again, or resumed.
        drop(start(&path, &Origin::default()).unwrap());
        drop(start(&path, &Origin::default()).unwrap());
        let resumed = Origin::find(&RunArgs { resume: Some(path.clone()), ..RunArgs::default() });
        assert_eq!(resumed, Origin { config: Some(path.clone()), checkpoint: None });
        start(&path, &resumed).unwrap().abandon();
        assert!(path.join("config.toml").exists(), "what was there before stays");
    }

    #[test]
    fn an_evaluator_that_came_first_makes_no_run_of_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(RunPaths::new(folder.path()).history(), "").unwrap();
        drop(start(folder.path(), &Origin::default()).unwrap());
        // Now there is a run, and it has been evaluated.
        let message = start(folder.path(), &Origin::default()).unwrap_err().to_string();
        assert!(message.contains("holds a run already"), "{message}");
    }

    #[test]
    fn a_run_that_has_learned_is_kept_and_begins_again_only_when_told_to_and_without_a_checkpoint() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run");
        drop(start(&path, &Origin::default()).unwrap());
        fs::write(RunPaths::new(&path).metrics(), "{}\n").unwrap();
        let message = start(&path, &Origin::default()).unwrap_err().to_string();
        assert!(message.contains("or continue it: `train --resume"), "{message}");
        let resumed = Origin::find(&RunArgs { resume: Some(path.clone()), ..RunArgs::default() });
        assert_eq!(resumed, Origin { config: Some(path.clone()), checkpoint: None }, "it was killed before it saved");
        drop(start(&path, &resumed).unwrap());
        // The learner rejects a folder without a run's configuration.
        let elsewhere = folder.path().join("elsewhere");
        let wrong = Origin::find(&RunArgs { resume: Some(elsewhere.clone()), ..RunArgs::default() });
        assert_eq!(wrong.checkpoint, Some(elsewhere));
    }

    #[test]
    fn a_run_that_goes_on_keeps_the_name_of_its_preset() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run");
        let preset = Preset::find("smoke").unwrap();
        drop(begin(&path, &Config::default(), Some(preset), &Origin::default()).unwrap());
        let resumed = Origin { config: Some(path.clone()), checkpoint: None };
        drop(start(&path, &resumed).unwrap());
        assert_eq!(preset_of(&RunPaths::new(&path)).as_deref(), Some("smoke"));
        fs::write(RunPaths::new(&path).meta(), "{}").unwrap();
        assert_eq!(preset_of(&RunPaths::new(&path)), None);
    }

    #[test]
    fn only_the_owner_can_read_a_token() {
        let folder = tempfile::tempdir().unwrap();
        let paths = RunPaths::new(folder.path());
        let mode = |file: PathBuf| fs::metadata(file).unwrap().permissions().mode() & 0o777;
        let config_with = |token: Option<&str>| {
            let web = WebConfig { token: token.map(|token| token.to_owned().into()), ..WebConfig::default() };
            Config { dashboard: DashboardConfig { web: Some(web) }, ..Config::default() }
        };
        let modes = |config: &Config| {
            drop(begin(folder.path(), config, None, &Origin::default()).unwrap());
            [mode(paths.config()), mode(paths.meta())]
        };
        assert_eq!(modes(&config_with(None)), [mode(paths.lock()); 2], "as for any file");
        let config = config_with(Some("0123456789abcdef"));
        assert_eq!(modes(&config), [0o600; 2]);
        fs::write(paths.meta(), r#"{ "command": ["--set", "dashboard.web.token=0123456789abcdef"] }"#).unwrap();
        let origin = origin_of(Some(&paths), &config).to_string();
        assert!(origin.contains("dashboard.web.token=…") && !origin.contains("0123456789"), "{origin}");
    }

    #[test]
    fn a_path_that_is_missing_is_named_with_the_one_that_was_meant() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for run in ["2026-11-26T0800-quickstart", "2026-11-26T0900-laptop", ".2026-11-26T0800-quickstrat.swp"] {
            fs::create_dir_all(path(run).join("checkpoints/step-2048")).unwrap();
        }
        let refused = |name: &str, suggestion: &str| {
            let message = check_exists(&path(name)).unwrap_err().to_string();
            assert_eq!(message, format!("{} does not exist{suggestion}", path(name).display()));
        };
        let meant = |name: &str| format!("; did you mean `{}`?", path(name).display());
        let run = "2026-11-26T0800-quickstart";
        refused("2026-11-26T0800-quickstrat", &meant(run));
        refused("2026-11-26T0800-quickstrat/checkpoints/step-2048", &meant(run));
        let checkpoints = format!("{run}/checkpoints/");
        refused(&format!("{checkpoints}step-2047"), &meant(&format!("{checkpoints}step-2048")));
        refused("zzz", "");
        assert!(check_exists(&path(run)).is_ok());
        let message = check_run(&path("gone")).unwrap_err().to_string();
        assert_eq!(message, format!("{} does not exist", path("gone").display()));
        let message = check_run(&path(run)).unwrap_err().to_string();
        assert!(message.contains("no folder of a run") && message.contains("config.toml"), "{message}");
    }

    #[test]
    fn a_folder_of_runs_names_the_newest() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(runs_in(folder.path()), "");
        assert_eq!(runs_in(&folder.path().join("gone")), "");
        for (name, seconds) in [("a", 20), ("b", 40), ("c", 10), ("d", 30)] {
            let run = folder.path().join(name);
            fs::create_dir_all(folder.path().join("no-run")).unwrap();
            fs::create_dir(&run).unwrap();
            let config = fs::File::create(RunPaths::new(&run).config()).unwrap();
            config.set_modified(SystemTime::UNIX_EPOCH + Duration::from_secs(seconds)).unwrap();
        }
        let names = ["b", "d", "a"].map(|name| folder.path().join(name).display().to_string()).join(", ");
        assert_eq!(runs_in(folder.path()), format!("; the newest runs in it: {names} and 1 more"));
    }

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

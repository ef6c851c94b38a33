//! Writes the metrics of one service: lines of `metrics.jsonl` and TensorBoard curves.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::PathBuf;

use proto::Role;
use serde::Serialize;
use serde_json::Value;

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
    /// A file or folder cannot be written.
    #[error("cannot write {}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// The metrics cannot be serialized as JSON.
    #[error("metrics are no JSON")]
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

    /// Appends lines in one write, so that lines of other writers cannot interleave. If the file ends in a part of a
    /// line, which a full disk or a power loss leaves behind, that line is ended first.
    ///
    /// # Errors
    /// If writing fails; some of the lines may have been written.
    pub fn append(&self, lines: &Lines) -> Result<(), WriteError> {
        let write = || {
            if let Some(folder) = self.path.parent() {
                fs::create_dir_all(folder)?;
            }
            let mut file = OpenOptions::new().create(true).read(true).append(true).open(&self.path)?;
            let end: &[u8] = if is_cut(&mut file)? { b"\n" } else { b"" };
            file.write_all(&[end, &lines.0].concat())
        };
        write().map_err(|source| WriteError::Io { path: self.path.clone(), source })
    }

    /// Writes the settings of the run, from the text of its `config.toml`, as text and to the table of hyperparameters.
    /// Leaves out `dashboard`, which holds the page's token: event files are shared.
    ///
    /// # Errors
    /// If writing fails.
    pub fn settings(&mut self, config: &str) -> Result<(), WriteError> {
        // A token in text that is not TOML could not be found.
        let Ok(mut settings) = toml::from_str::<toml::Table>(config) else { return Ok(()) };
        settings.remove("dashboard");
        let hyperparameters = serde_json::to_value(&settings)?;
        let mut write = || {
            self.tensorboard.text(0, "settings", &format!("```toml\n{settings}```"))?;
            self.tensorboard.hyperparameters(&hyperparameters)
        };
        write().map_err(|source| WriteError::Io { path: self.path.with_file_name("tb"), source })
    }

    /// Adds a point to each named curve at a number of environment steps. Counts and PPO metrics have no points where
    /// they are 0, so that TensorBoard does not open on a page of zeros while the policy learns from labels and nothing
    /// is dropped.
    ///
    /// # Errors
    /// If writing fails.
    pub fn scalars(
        &mut self,
        n_env_steps: u64,
        scalars: impl IntoIterator<Item = (String, f64)>,
    ) -> Result<(), WriteError> {
        let is_quiet = |tag: &str| {
            ["bus/", "ingest/", "ppo/"].iter().any(|start| tag.starts_with(start)) || tag.ends_with("_total")
        };
        let is_shown = |(tag, value): &(String, f64)| *value != 0.0 || !is_quiet(tag);
        let written = self.tensorboard.scalars(n_env_steps, scalars.into_iter().filter(is_shown));
        written.map_err(|source| WriteError::Io { path: self.path.with_file_name("tb"), source })
    }
}

/// Returns whether the file ends in the middle of a line.
fn is_cut(file: &mut File) -> io::Result<bool> {
    let mut last = [b'\n'];
    if file.metadata()?.len() > 0 {
        file.seek(SeekFrom::End(-1))?;
        file.read_exact(&mut last)?;
    }
    Ok(last != [b'\n'])
}

/// Returns the last line of `metrics.jsonl` under `key` that `accepts` accepts, among the last 4 MiB; `None` if there
/// is none.
///
/// # Errors
/// If the file exists and cannot be read.
pub fn last_line(paths: &RunPaths, key: &str, accepts: impl Fn(&Value) -> bool) -> io::Result<Option<Value>> {
    /// Holds hundreds of updates, each below 20 KB.
    const TAIL: u64 = 4 << 20;
    let mut file = match File::open(paths.metrics()) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        opened => opened?,
    };
    let start = file.metadata()?.len().saturating_sub(TAIL);
    file.seek(SeekFrom::Start(start))?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes)?;
    // A line cut off at the front, or at the end by a kill, is not valid JSON.
    let lines = bytes.rsplit(|byte| *byte == b'\n').filter_map(|line| serde_json::from_slice::<Value>(line).ok());
    Ok(lines.filter(|line| line["key"] == key).find(accepts))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn counts_and_ppo_have_no_points_at_zero() {
        let folder = tempfile::tempdir().unwrap();
        let paths = RunPaths::new(folder.path());
        let mut writer = MetricsWriter::open(&paths, Role::Learner).unwrap();
        let scalars = [
            ("ppo/entropy", 0.0),
            ("ingest/stale_total", 0.0),
            ("learner/expired_total", 0.0),
            ("ppo/grad_norm", 0.5),
            ("learner/policy_lag_mean", 0.0),
        ];
        writer.scalars(1, scalars.map(|(tag, value)| (tag.to_owned(), value))).unwrap();
        let events = String::from_utf8_lossy(&fs::read(writer.tensorboard.path()).unwrap()).into_owned();
        let written = scalars.map(|(tag, _)| events.contains(tag));
        assert_eq!(written, [false, false, false, true, true]);
    }

    #[test]
    fn the_token_stays_out_of_event_files() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = MetricsWriter::open(&RunPaths::new(folder.path()), Role::Learner).unwrap();
        let token = "0123456789abcdef";
        let page = format!("[dashboard.web]\nlisten = \"0.0.0.0:80\"\ntoken = \"{token}\"\n");
        writer.settings(&format!("seed = 1\n\n{page}\n[learner]\ngamma = 0.9\n")).unwrap();
        writer.settings(&format!("{page}no TOML\n")).unwrap();
        let events = String::from_utf8_lossy(&fs::read(writer.tensorboard.path()).unwrap()).into_owned();
        for shown in ["seed = 1\n\n[learner]\ngamma = 0.9\n```", "learner.gamma"] {
            assert!(events.contains(shown), "{events}");
        }
        assert!(!events.contains(token) && !events.contains("dashboard"), "{events}");
    }

    #[test]
    fn a_line_that_was_cut_does_not_spoil_the_next_one() {
        let folder = tempfile::tempdir().unwrap();
        let paths = RunPaths::new(folder.path());
        let cut = || OpenOptions::new().append(true).open(paths.metrics()).unwrap().write_all(b"{\"key\":").unwrap();
        let mut line = Lines::default();
        line.push("learner", &json!({ "n": 1 })).unwrap();
        let whole = "{\"key\":\"learner\",\"n\":1}\n";
        let writer = MetricsWriter::open(&paths, Role::Learner).unwrap();
        writer.append(&line).unwrap();
        cut();
        writer.append(&line).unwrap();
        cut();
        MetricsWriter::open(&paths, Role::Evaluator).unwrap();
        writer.append(&line).unwrap();
        let written = fs::read_to_string(paths.metrics()).unwrap();
        assert_eq!(written, format!("{whole}{{\"key\":\n{whole}{{\"key\":\n{whole}"));
    }

    #[test]
    fn the_last_line_of_a_key_is_found() {
        let folder = tempfile::tempdir().unwrap();
        let paths = RunPaths::new(folder.path());
        assert_eq!(last_line(&paths, "learner", |_| true).unwrap(), None);
        let writer = MetricsWriter::open(&paths, Role::Learner).unwrap();
        let mut lines = Lines::default();
        for (key, n) in [("learner", 1), ("learner", 2), ("eval/summary", 3)] {
            lines.push(key, &json!({ "n": n })).unwrap();
        }
        writer.append(&lines).unwrap();
        let mut file = OpenOptions::new().append(true).open(paths.metrics()).unwrap();
        file.write_all(b"{\"key\":\"learner\",\"n\":4").unwrap();
        let found = |below: u64| {
            let line = last_line(&paths, "learner", |line| line["n"].as_u64().unwrap() < below).unwrap();
            line.map(|line| line["n"].as_u64().unwrap())
        };
        assert_eq!((found(9), found(2), found(1)), (Some(2), Some(1), None));
    }
}

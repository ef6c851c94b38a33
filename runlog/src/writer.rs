//! Writes the metrics of one service: lines of `metrics.jsonl` and TensorBoard curves.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::path::PathBuf;

use proto::Role;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::RunPaths;
use crate::series::push_newer;
use crate::tensorboard::{EventWriter, event_files};

/// Maximum length of a line that is read, in bytes; those of a learner have below 20 KB.
const MAX_LINE_BYTES: u64 = 1 << 20;

/// Writes the metrics of one service; other services may append to the same `metrics.jsonl`.
#[derive(Debug)]
pub struct MetricsWriter {
    path: PathBuf,
    tensorboard: EventWriter,
    /// Whether earlier processes left curves that this one has not gone on from yet.
    goes_on: bool,
}

/// Errors of writing metrics.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// A file or folder cannot be written.
    #[error("cannot write {0}")]
    Io(PathBuf, #[source] io::Error),
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
        let open = || Ok((!event_files(&folder)?.is_empty(), EventWriter::create(&folder)?));
        let (goes_on, tensorboard) = open().map_err(|error| WriteError::Io(folder.clone(), error))?;
        let writer = Self { path: paths.metrics(), tensorboard, goes_on };
        // Detect an error now rather than at the first update.
        writer.append(&Lines::default())?;
        Ok(writer)
    }

    /// Goes on from a checkpoint of `n_env_steps` environment steps: removes the lines of later steps, which belong to
    /// abandoned weights, and tells TensorBoard to forget them, so that steps only grow.
    ///
    /// # Errors
    /// If the files cannot be changed.
    pub fn resume(&mut self, n_env_steps: u64) -> Result<(), WriteError> {
        self.locked(|file| keep_until(file, n_env_steps))?;
        // The checkpoint's own steps stay.
        self.restart(n_env_steps + 1)
    }

    /// Appends all lines or, if that fails, none, so that no reader finds a part of a line. A part that a killed
    /// process left at the end is removed first.
    ///
    /// # Errors
    /// If writing fails.
    pub fn append(&self, lines: &Lines) -> Result<(), WriteError> {
        self.locked(|file| {
            let end = end_of_lines(file)?;
            file.set_len(end)?;
            file.seek(SeekFrom::Start(end))?;
            write_or_undo(file, &lines.0, |file| file.set_len(end))
        })
    }

    /// Changes `metrics.jsonl` while no other process does.
    fn locked(&self, change: impl FnOnce(&mut File) -> io::Result<()>) -> Result<(), WriteError> {
        let open = || {
            if let Some(folder) = self.path.parent() {
                fs::create_dir_all(folder)?;
            }
            let mut file = OpenOptions::new().create(true).read(true).write(true).truncate(false).open(&self.path)?;
            // The lock ends with `file`.
            file.lock()?;
            change(&mut file)
        };
        open().map_err(|error| WriteError::Io(self.path.clone(), error))
    }

    /// Tells TensorBoard, once, to forget what earlier processes wrote at `n_env_steps` or later.
    fn restart(&mut self, n_env_steps: u64) -> Result<(), WriteError> {
        if self.goes_on {
            self.write_events(|tensorboard| tensorboard.restart(n_env_steps))?;
            self.goes_on = false;
        }
        Ok(())
    }

    /// Changes the event files; an error names their folder.
    fn write_events(&mut self, write: impl FnOnce(&mut EventWriter) -> io::Result<()>) -> Result<(), WriteError> {
        write(&mut self.tensorboard).map_err(|error| WriteError::Io(self.path.with_file_name("tb"), error))
    }

    /// Writes the settings of the run, from the text of its `config.toml`, to TensorBoard's table of hyperparameters.
    /// Leaves out `dashboard`, which holds the page's token: event files are shared.
    ///
    /// # Errors
    /// If writing fails.
    pub fn settings(&mut self, config: &str) -> Result<(), WriteError> {
        // A token in text that is not TOML could not be found.
        let Ok(mut settings) = toml::from_str::<serde_json::Map<_, _>>(config) else { return Ok(()) };
        settings.remove("dashboard");
        self.write_events(|tensorboard| tensorboard.hyperparameters(&settings.into()))
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
        self.restart(n_env_steps)?;
        let shown = scalars.into_iter().filter(|(tag, value)| *value != 0.0 || !is_quiet(tag));
        self.write_events(|tensorboard| tensorboard.scalars(n_env_steps, shown))
    }
}

/// Writes all bytes or, after an error, calls `undo`.
fn write_or_undo<F: Write>(file: &mut F, bytes: &[u8], undo: impl FnOnce(&mut F) -> io::Result<()>) -> io::Result<()> {
    let written = file.write_all(bytes);
    if written.is_err() {
        // The first error explains more; what stays is removed before the next line.
        let _ = undo(file);
    }
    written
}

/// Returns the length of the file without the part of a line at its end.
fn end_of_lines(file: &mut File) -> io::Result<u64> {
    const BLOCK: u64 = 1 << 16;
    let mut end = file.metadata()?.len();
    while end > 0 {
        let start = end.saturating_sub(BLOCK);
        let mut block = Vec::new();
        file.seek(SeekFrom::Start(start))?;
        (&*file).take(end - start).read_to_end(&mut block)?;
        if let Some(place) = block.iter().rposition(|byte| *byte == b'\n') {
            return Ok(start + place as u64 + 1);
        }
        end = start;
    }
    Ok(0)
}

/// Removes the lines of more than `n_env_steps` environment steps, and broken ones. The rest of the file is written
/// over, not copied, so that a full disk cannot prevent it.
fn keep_until(file: &mut File, n_env_steps: u64) -> io::Result<()> {
    let mut whole = 0;
    let mut kept = Vec::new();
    let mut is_whole = true;
    let mut reader = BufReader::new(&*file);
    let mut line = Vec::new();
    while reader.read_until(b'\n', &mut line)? > 0 {
        let stays = line.ends_with(b"\n") && steps(&line).is_some_and(|steps| steps <= n_env_steps);
        is_whole &= stays;
        match stays {
            true if is_whole => whole += line.len() as u64,
            true => kept.extend_from_slice(&line),
            false => {}
        }
        line.clear();
    }
    if !is_whole {
        file.seek(SeekFrom::Start(whole))?;
        file.write_all(&kept)?;
        file.set_len(whole + kept.len() as u64)?;
    }
    Ok(())
}

/// Returns the environment steps of a line, 0 if it has none; `None` if it is broken.
fn steps(line: &[u8]) -> Option<u64> {
    #[derive(Deserialize)]
    struct Steps {
        #[serde(default)]
        n_env_steps: u64,
    }
    Some(serde_json::from_slice::<Steps>(line).ok()?.n_env_steps)
}

/// Returns the values of all lines under `key` that lead to the last one, with growing `n_env_steps`, and the number of
/// lines that could not be read. Runs of earlier versions repeat steps after they were resumed.
///
/// # Errors
/// If the file exists and cannot be read.
pub fn lines<M: DeserializeOwned>(
    paths: &RunPaths,
    key: &str,
    n_env_steps: impl Fn(&M) -> u64,
) -> io::Result<(Vec<M>, usize)> {
    let file = match File::open(paths.metrics()) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok((Vec::new(), 0)),
        opened => opened?,
    };
    let start = format!("{{\"key\":\"{key}\"").into_bytes();
    let (mut found, mut n_unread): (Vec<M>, usize) = (Vec::new(), 0);
    let mut reader = BufReader::new(file);
    let mut line = Vec::new();
    while (&mut reader).take(MAX_LINE_BYTES).read_until(b'\n', &mut line)? > 0 {
        if line.starts_with(&start) {
            match serde_json::from_slice::<M>(&line) {
                Ok(value) => push_newer(&mut found, value, &n_env_steps),
                Err(_) => n_unread += 1,
            }
        }
        line.clear();
    }
    Ok((found, n_unread))
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;

    /// What the learner's event file says, with the numbers as they are.
    fn events(paths: &RunPaths) -> String {
        let files = event_files(&paths.tensorboard(Role::Learner)).unwrap();
        String::from_utf8_lossy(&fs::read(&files[0]).unwrap()).into_owned()
    }

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
        let events = events(&paths);
        let written = scalars.map(|(tag, _)| events.contains(tag));
        assert_eq!(written, [false, false, false, true, true]);
    }

    #[test]
    fn the_token_stays_out_of_event_files() {
        let folder = tempfile::tempdir().unwrap();
        let paths = RunPaths::new(folder.path());
        let mut writer = MetricsWriter::open(&paths, Role::Learner).unwrap();
        let token = "0123456789abcdef";
        let page = format!("[dashboard.web]\nlisten = \"0.0.0.0:80\"\ntoken = \"{token}\"\n");
        writer.settings(&format!("seed = 1\n\n{page}\n[learner]\ngamma = 0.9\n")).unwrap();
        writer.settings(&format!("{page}no TOML\n")).unwrap();
        let events = events(&paths);
        assert!(events.contains("learner.gamma"), "{events}");
        assert!(!events.contains(token) && !events.contains("dashboard"), "{events}");
    }

    /// A file on a disk with room for a few more bytes.
    struct Disk {
        bytes: Vec<u8>,
        room: usize,
    }

    impl Write for Disk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let n_bytes = bytes.len().min(self.room - self.bytes.len());
            self.bytes.extend(&bytes[..n_bytes]);
            if n_bytes == 0 { Err(io::ErrorKind::StorageFull.into()) } else { Ok(n_bytes) }
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_full_disk_leaves_no_part_of_a_line() {
        let (before, line) = (b"{\"n\":1}\n", b"{\"n\":2}\n");
        for room in before.len()..before.len() + line.len() {
            let mut disk = Disk { bytes: before.to_vec(), room };
            let undo = |disk: &mut Disk| {
                disk.bytes.truncate(before.len());
                Ok(())
            };
            let error = write_or_undo(&mut disk, line, undo).unwrap_err();
            assert_eq!((error.kind(), &disk.bytes[..]), (io::ErrorKind::StorageFull, &before[..]), "room for {room}");
        }
    }

    #[test]
    fn a_line_that_was_cut_is_removed_before_the_next_one() {
        let folder = tempfile::tempdir().unwrap();
        let paths = RunPaths::new(folder.path());
        let cut = |part: &[u8]| OpenOptions::new().append(true).open(paths.metrics()).unwrap().write_all(part).unwrap();
        let mut line = Lines::default();
        line.push("learner", &json!({ "n": 1 })).unwrap();
        let whole = "{\"key\":\"learner\",\"n\":1}\n";
        let writer = MetricsWriter::open(&paths, Role::Learner).unwrap();
        cut(b"{\"key\":");
        writer.append(&line).unwrap();
        // Longer than what is read at once.
        cut(&[b' '; 200_000]);
        writer.append(&line).unwrap();
        cut(b"{");
        MetricsWriter::open(&paths, Role::Evaluator).unwrap();
        assert_eq!(fs::read_to_string(paths.metrics()).unwrap(), whole.repeat(2));
    }

    #[test]
    fn steps_only_grow_after_a_resume() {
        let folder = tempfile::tempdir().unwrap();
        let paths = RunPaths::new(folder.path());
        let append = |writer: &MetricsWriter, key: &str, n_env_steps: u64, n: u64| {
            let mut line = Lines::default();
            line.push(key, &json!({ "n_env_steps": n_env_steps, "n": n })).unwrap();
            writer.append(&line).unwrap();
        };
        let writer = MetricsWriter::open(&paths, Role::Learner).unwrap();
        // The evaluation of the first weights ends after an update that is lost.
        for (key, steps, n) in [("learner", 100, 1), ("learner", 200, 2), ("eval/summary", 100, 3), ("learner", 300, 4)]
        {
            append(&writer, key, steps, n);
        }
        let broken = b"{\"key\":\"learner\",\"n_e\n{\"key\":\"lear";
        OpenOptions::new().append(true).open(paths.metrics()).unwrap().write_all(broken).unwrap();
        let mut writer = MetricsWriter::open(&paths, Role::Learner).unwrap();
        writer.resume(100).unwrap();
        append(&writer, "learner", 250, 5);
        let text = fs::read_to_string(paths.metrics()).unwrap();
        let found: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert_eq!(found.iter().map(|line| line["n"].as_u64().unwrap()).collect::<Vec<_>>(), [1, 3, 5]);
    }

    #[test]
    fn repeated_steps_of_earlier_versions_are_read_once() {
        let folder = tempfile::tempdir().unwrap();
        let paths = RunPaths::new(folder.path());
        let read = || lines::<Value>(&paths, "learner", |line| line["n_env_steps"].as_u64().unwrap()).unwrap();
        assert_eq!(read(), (Vec::new(), 0));
        let line = |n: u64| format!("{{\"key\":\"learner\",\"n_env_steps\":{n}}}\n");
        let others = "{\"key\":\"actor/a\"}\n{\"key\":\"learner\",\"half\n";
        fs::write(paths.metrics(), [line(1), line(3), others.to_owned(), line(2), line(4)].concat()).unwrap();
        let (found, n_unread) = read();
        assert_eq!(found.iter().map(|line| line["n_env_steps"].as_u64().unwrap()).collect::<Vec<_>>(), [1, 2, 4]);
        assert_eq!(n_unread, 1);
    }
}

//! Metrics as TensorBoard event files. TensorBoard reads every file below a given folder.
//!
//! A file is a sequence of records (length, checksum, data, checksum), each an `Event` message in protobuf; see
//! `tensorflow/core/lib/io/record_writer.h` and `tensorflow/core/util/event.proto` upstream. Only the parts of the
//! message for scalars and hyperparameters are defined here.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use prost::Message;
use serde_json::Value;

#[derive(Clone, PartialEq, Message)]
struct Event {
    /// Seconds since 1970.
    #[prost(double, tag = "1")]
    wall_time: f64,
    #[prost(int64, tag = "2")]
    step: i64,
    #[prost(string, optional, tag = "3")]
    file_version: Option<String>,
    #[prost(message, optional, tag = "5")]
    summary: Option<Summary>,
    #[prost(message, optional, tag = "7")]
    session_log: Option<SessionLog>,
}

#[derive(Clone, PartialEq, Message)]
struct SessionLog {
    /// [`SESSION_START`].
    #[prost(int32, tag = "1")]
    status: i32,
}

#[derive(Clone, PartialEq, Message)]
struct Summary {
    #[prost(message, repeated, tag = "1")]
    values: Vec<Tagged>,
}

#[derive(Clone, PartialEq, Message)]
struct Tagged {
    #[prost(string, tag = "1")]
    tag: String,
    /// Optional: a plain 0 would not be written, and readers would find no value.
    #[prost(float, optional, tag = "2")]
    simple_value: Option<f32>,
    #[prost(message, optional, tag = "9")]
    metadata: Option<Metadata>,
}

/// The TensorBoard plugin that shows a value.
#[derive(Clone, PartialEq, Message)]
struct Metadata {
    #[prost(message, optional, tag = "1")]
    plugin: Option<Plugin>,
}

#[derive(Clone, PartialEq, Message)]
struct Plugin {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(bytes = "vec", tag = "2")]
    content: Vec<u8>,
}

/// The content of the plugin `hparams`; see `tensorboard/plugins/hparams/plugin_data.proto` upstream.
#[derive(Clone, PartialEq, Message)]
struct Hyperparameters {
    #[prost(message, optional, tag = "3")]
    session: Option<SessionStart>,
}

#[derive(Clone, PartialEq, Message)]
struct SessionStart {
    #[prost(btree_map = "string, message", tag = "1")]
    by_name: BTreeMap<String, Setting>,
    /// Seconds since 1970.
    #[prost(double, tag = "5")]
    start_time: f64,
}

/// The parts of `google.protobuf.Value` that a setting uses.
#[derive(Clone, PartialEq, Message)]
struct Setting {
    #[prost(oneof = "SettingKind", tags = "2, 3, 4")]
    kind: Option<SettingKind>,
}

#[derive(Clone, PartialEq, prost::Oneof)]
enum SettingKind {
    #[prost(double, tag = "2")]
    Number(f64),
    #[prost(string, tag = "3")]
    Text(String),
    #[prost(bool, tag = "4")]
    Switch(bool),
}

/// `SessionLog.START`.
const SESSION_START: i32 = 1;

/// Beginning of the name of every event file, which readers require.
const PREFIX: &str = "events.out.tfevents.";

/// Appends to one event file.
#[derive(Debug)]
pub(crate) struct EventWriter {
    /// Open for appending, so that a write follows what is left after a cut record is removed.
    file: File,
    /// Length of the whole records.
    n_bytes: u64,
    /// Whether a write has failed, which may have left a part of its record.
    is_cut: bool,
}

impl EventWriter {
    /// Creates a new file in `folder`, which is created if needed.
    pub(crate) fn create(folder: &Path) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        let path = folder.join(next_name(&event_files(folder)?, since_1970()));
        let file = File::options().append(true).create_new(true).open(&path)?;
        let mut writer = Self { file, n_bytes: 0, is_cut: false };
        let file_version = Some("brain.Event:2".to_owned());
        writer.append(Event { file_version, ..Event::default() })?;
        Ok(writer)
    }

    /// Tells readers to forget what earlier files of the folder have at `step` or later.
    pub(crate) fn restart(&mut self, step: u64) -> io::Result<()> {
        let session_log = Some(SessionLog { status: SESSION_START });
        self.append(Event { step: signed(step), session_log, ..Event::default() })
    }

    /// Appends scalars by tag at `step`, in one write.
    pub(crate) fn scalars(&mut self, step: u64, scalars: impl IntoIterator<Item = (String, f64)>) -> io::Result<()> {
        let number = |(tag, value)| Tagged { tag, simple_value: Some(value as f32), ..Tagged::default() };
        self.summary(step, scalars.into_iter().map(number).collect())
    }

    /// Sets the run's row in TensorBoard's table of hyperparameters: every setting under its path, such as
    /// `learner.gamma`. Lists are shown as JSON.
    pub(crate) fn hyperparameters(&mut self, settings: &Value) -> io::Result<()> {
        let mut by_name = BTreeMap::new();
        collect("", settings, &mut by_name);
        let session = Some(SessionStart { by_name, start_time: since_1970() });
        let content = Hyperparameters { session }.encode_to_vec();
        let metadata = Some(Metadata { plugin: Some(Plugin { name: "hparams".to_owned(), content }) });
        // TensorBoard finds them by this tag.
        let tag = "_hparams_/session_start_info".to_owned();
        self.summary(0, vec![Tagged { tag, metadata, ..Tagged::default() }])
    }

    fn summary(&mut self, step: u64, values: Vec<Tagged>) -> io::Result<()> {
        self.append(Event { step: signed(step), summary: Some(Summary { values }), ..Event::default() })
    }

    fn append(&mut self, event: Event) -> io::Result<()> {
        let bytes = record(&Event { wall_time: since_1970(), ..event }.encode_to_vec());
        // Readers stop at a record that is cut short, so nothing after it would ever be seen.
        if self.is_cut {
            self.file.set_len(self.n_bytes)?;
        }
        self.is_cut = true;
        self.file.write_all(&bytes)?;
        self.is_cut = false;
        self.n_bytes += bytes.len() as u64;
        Ok(())
    }
}

/// Returns the event files in the folder that an [`EventWriter`] named, oldest first. Files of other programs end in
/// more than numbers.
pub(crate) fn event_files(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries?,
    };
    let mut files = Vec::new();
    for entry in entries {
        let entry = entry?;
        let name = entry.file_name();
        let numbers = name.as_encoded_bytes().strip_prefix(PREFIX.as_bytes());
        let is_ours = numbers.is_some_and(|numbers| numbers.iter().all(|c| c.is_ascii_digit() || *c == b'.'));
        if is_ours && entry.file_type()?.is_file() {
            files.push(entry.path());
        }
    }
    files.sort();
    Ok(files)
}

/// Returns the name of a new event file: readers take files in the order of their names, so that it follows the newest
/// of the folder's `files` even if the clock has been set back.
fn next_name(files: &[PathBuf], now: f64) -> String {
    let stamp = |path: &PathBuf| {
        let name = path.file_name()?.to_str()?.strip_prefix(PREFIX)?;
        let mut numbers = name.split('.').map(|number| number.parse::<u64>().ok());
        numbers.next()??.checked_mul(1_000_000)?.checked_add(numbers.next()??)
    };
    let next = files.iter().filter_map(stamp).max().map_or(0, |newest| newest.saturating_add(1));
    let micros = ((now * 1e6) as u64).max(next);
    format!("{PREFIX}{:010}.{:06}.{}", micros / 1_000_000, micros % 1_000_000, std::process::id())
}

fn signed(step: u64) -> i64 {
    i64::try_from(step).unwrap_or(i64::MAX)
}

/// Flattens metrics to numbers tagged by the path of names: `<root>/<name>` at the top level, `<name>/…/<name>` below.
/// Lists and the values of names in `skipped` are left out.
pub fn flatten(root: &str, metrics: &Value, skipped: &[&str]) -> Vec<(String, f64)> {
    let mut scalars = Vec::new();
    for (name, value) in fields(metrics, skipped) {
        match value.as_f64() {
            Some(number) => scalars.push((format!("{root}/{name}"), number)),
            None => descend(name, value, skipped, &mut scalars),
        }
    }
    scalars
}

fn descend(path: &str, value: &Value, skipped: &[&str], scalars: &mut Vec<(String, f64)>) {
    scalars.extend(value.as_f64().map(|number| (path.to_owned(), number)));
    for (name, value) in fields(value, skipped) {
        descend(&format!("{path}/{name}"), value, skipped, scalars);
    }
}

fn fields<'v>(value: &'v Value, skipped: &[&str]) -> impl Iterator<Item = (&'v String, &'v Value)> {
    value.as_object().into_iter().flatten().filter(|(name, _)| !skipped.contains(&name.as_str()))
}

/// Adds the settings below `path` under their own paths.
fn collect(path: &str, value: &Value, settings: &mut BTreeMap<String, Setting>) {
    let kind = match value {
        Value::Null => return,
        Value::Bool(switch) => SettingKind::Switch(*switch),
        Value::Number(number) => SettingKind::Number(number.as_f64().unwrap_or(f64::NAN)),
        Value::String(text) => SettingKind::Text(text.clone()),
        Value::Array(_) => SettingKind::Text(value.to_string()),
        Value::Object(fields) => {
            for (name, value) in fields {
                let path = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
                collect(&path, value, settings);
            }
            return;
        }
    };
    settings.insert(path.to_owned(), Setting { kind: Some(kind) });
}

fn record(data: &[u8]) -> Vec<u8> {
    let length = (data.len() as u64).to_le_bytes();
    [&length[..], &masked_checksum(&length), data, &masked_checksum(data)].concat()
}

/// Returns the checksum as stored: rotated and offset, so that it stays robust for data that contains checksums.
fn masked_checksum(data: &[u8]) -> [u8; 4] {
    crc32c::crc32c(data).rotate_right(15).wrapping_add(0xa282_ead8).to_le_bytes()
}

/// Returns the seconds since 1970; 0 if the clock is earlier.
fn since_1970() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |time| time.as_secs_f64())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    /// The bytes of the only file in a folder.
    fn written(folder: &Path) -> Vec<u8> {
        fs::read(&event_files(folder).unwrap()[0]).unwrap()
    }

    /// The events of a file that consists of whole records.
    fn events(folder: &Path) -> Vec<Event> {
        let bytes = written(folder);
        let mut rest = &bytes[..];
        let mut events = Vec::new();
        while !rest.is_empty() {
            let length = u64::from_le_bytes(rest[..8].try_into().unwrap()) as usize;
            events.push(Event::decode(&rest[12..12 + length]).unwrap());
            rest = &rest[12 + length + 4..];
        }
        events
    }

    #[test]
    fn record_framing_matches_upstream() {
        // CRC-32C of eight zero bytes is 0x8c28b28a (RFC 3720's polynomial), here rotated right by 15 and offset.
        let checksum = 0x8c28_b28a_u32.rotate_right(15).wrapping_add(0xa282_ead8).to_le_bytes();
        let empty = record(&[]);
        assert_eq!(empty[..8], [0; 8]);
        assert_eq!(empty[8..12], checksum);
        // The checksum of empty data is 0.
        assert_eq!(empty[12..], 0xa282_ead8_u32.to_le_bytes());
    }

    #[test]
    fn event_file_has_version_scalars_and_settings() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("learner");
        let mut writer = EventWriter::create(&folder).unwrap();
        writer.scalars(4096, [("ppo/entropy".to_owned(), 1.5), ("learner/n_updates".to_owned(), 0.0)]).unwrap();
        let settings =
            json!({ "seed": 1, "learner": { "gamma": 0.99, "adapt": true, "points": [[0, 0.5]] }, "device": "cpu" });
        writer.hyperparameters(&settings).unwrap();
        let name = fs::read_dir(&folder).unwrap().next().unwrap().unwrap().file_name();
        assert!(name.to_str().unwrap().starts_with("events.out.tfevents."));
        let events = events(&folder);
        assert_eq!(events.len(), 3);
        assert_eq!(events[0].file_version.as_deref(), Some("brain.Event:2"));
        assert_eq!(events[1].step, 4096);
        let values = |at: usize| &events[at].summary.as_ref().unwrap().values[..];
        let scalar = |tag: &str, value| Tagged { tag: tag.to_owned(), simple_value: Some(value), ..Tagged::default() };
        assert_eq!(values(1), [scalar("ppo/entropy", 1.5), scalar("learner/n_updates", 0.0)]);
        let row = &values(2)[0];
        let plugin = row.metadata.as_ref().unwrap().plugin.as_ref().unwrap();
        assert_eq!((row.tag.as_str(), plugin.name.as_str()), ("_hparams_/session_start_info", "hparams"));
        let session = Hyperparameters::decode(&plugin.content[..]).unwrap().session.unwrap();
        let wanted = [
            ("device", SettingKind::Text("cpu".to_owned())),
            ("learner.adapt", SettingKind::Switch(true)),
            ("learner.gamma", SettingKind::Number(0.99)),
            ("learner.points", SettingKind::Text("[[0,0.5]]".to_owned())),
            ("seed", SettingKind::Number(1.0)),
        ];
        let wanted = wanted.map(|(name, kind)| (name.to_owned(), Setting { kind: Some(kind) }));
        assert_eq!(session.by_name, BTreeMap::from(wanted));
    }

    #[test]
    fn a_new_file_follows_the_older_ones_whatever_the_clock_says() {
        let dir = tempfile::tempdir().unwrap();
        let newest = dir.path().join(format!("{PREFIX}9999999998.999999.7"));
        fs::write(&newest, "").unwrap();
        let other = dir.path().join(format!("{PREFIX}9999999999.host"));
        fs::write(other, "").unwrap();
        let create = || {
            EventWriter::create(dir.path()).unwrap();
            event_files(dir.path()).unwrap()
        };
        let [one, two] = [create(), create()];
        assert_eq!((&one[0], one.len()), (&newest, 2));
        assert_eq!((&two[..2], two.len()), (&one[..], 3));
        let id = std::process::id();
        assert_eq!(next_name(&[], 0.0), format!("{PREFIX}0000000000.000000.{id}"), "before 1970");
        let old = PathBuf::from(next_name(&[], 1_700_000_000.5));
        assert_eq!(next_name(&[old], 1_600_000_000.0), format!("{PREFIX}1700000000.500001.{id}"));
    }

    #[test]
    fn a_restart_is_the_start_of_a_session_at_its_step() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = EventWriter::create(dir.path()).unwrap();
        writer.restart(12_000).unwrap();
        let event = events(dir.path()).pop().unwrap();
        assert_eq!((event.step, event.session_log, event.summary), (12_000, Some(SessionLog { status: 1 }), None));
    }

    #[test]
    fn a_record_that_is_cut_short_is_removed_before_the_next() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = EventWriter::create(dir.path()).unwrap();
        writer.scalars(1, [("a".to_owned(), 1.0)]).unwrap();
        // A write that fails in its middle, as on a full disk.
        let whole = written(dir.path());
        fs::write(&event_files(dir.path()).unwrap()[0], [&whole[..], b"\x10\0\0"].concat()).unwrap();
        writer.is_cut = true;
        writer.scalars(2, [("a".to_owned(), 2.0)]).unwrap();
        assert!(written(dir.path()).starts_with(&whole));
        assert_eq!(events(dir.path()).iter().map(|event| event.step).collect::<Vec<_>>(), [0, 1, 2]);
    }

    #[test]
    fn flatten_tags_numbers_by_path() {
        let metrics = json!({
            "n_updates": 3, "who": "x", "none": null, "lags": [1, 2], "schema_version": 1,
            "ppo": { "entropy": 0.5 }, "episodes": { "success": { "rate": 0.25 }, "by": { "2_000": 1 } },
        });
        let mut found = flatten("learner", &metrics, &["schema_version", "by"]);
        found.sort_by(|a, b| a.0.cmp(&b.0));
        let wanted = [("episodes/success/rate", 0.25), ("learner/n_updates", 3.0), ("ppo/entropy", 0.5)];
        assert_eq!(found, wanted.map(|(tag, value)| (tag.to_owned(), value)));
    }
}

//! Videos and their recordings: `<folder>/<blueprint>/<version>-<ending>.<kind>`, the newest of each.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use blueprints::BlueprintId;
use proto::WeightsVersion;

/// The outcome of a video's episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Ending {
    /// The blueprint was completed.
    Success,
    /// The blueprint was not completed.
    Failure,
}

impl Ending {
    /// Both endings.
    pub const ALL: [Self; 2] = [Self::Success, Self::Failure];

    /// Returns the name in file names: `success` or `failure`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::Failure => "failure",
        }
    }
}

/// File extension of recordings.
pub const RECORDING: &str = "trajectory";

/// A store for video files of one kind.
#[derive(Clone, Debug)]
pub struct VideoStore {
    /// The folder with one subfolder per blueprint.
    pub folder: PathBuf,
    /// File extension of the videos.
    pub kind: &'static str,
    /// Number of files kept per blueprint and ending.
    pub keep: usize,
}

/// The fields of a file name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct VideoName {
    /// Version of the acting weights.
    pub version: WeightsVersion,
    /// The outcome of the episode.
    pub ending: Ending,
}

impl VideoName {
    /// Returns the file name without the extension; the names of a blueprint sort by version.
    pub fn name(&self) -> String {
        format!("{:08}-{}", self.version.0, self.ending.name())
    }

    fn file(&self, kind: &str) -> String {
        format!("{}.{kind}", self.name())
    }

    /// Parses a file name with the extension `kind`; returns `None` for foreign files.
    fn of(file: &str, kind: &str) -> Option<Self> {
        let (version, ending) = file.strip_suffix(kind)?.strip_suffix('.')?.split_once('-')?;
        let ending = Ending::ALL.into_iter().find(|known| known.name() == ending)?;
        let label = Self { version: WeightsVersion(version.parse().ok()?), ending };
        (label.file(kind) == file).then_some(label)
    }
}

/// Returns the videos of a kind in the folder of a blueprint, without foreign files.
fn labels(folder: &Path, kind: &str) -> io::Result<Vec<VideoName>> {
    let entries = fs::read_dir(folder)?.collect::<io::Result<Vec<_>>>()?;
    Ok(entries.iter().filter_map(|entry| VideoName::of(entry.file_name().to_str()?, kind)).collect())
}

impl VideoStore {
    /// Writes a file atomically through a temporary name, and removes the oldest files beyond the limit. Videos of newer
    /// versions are from before the run went back to an older checkpoint, so they count as the oldest.
    ///
    /// # Errors
    /// If writing fails.
    pub fn put(&self, blueprint: &BlueprintId, label: VideoName, bytes: &[u8]) -> io::Result<PathBuf> {
        let folder = self.folder.join(blueprint.as_str());
        fs::create_dir_all(&folder)?;
        let name = label.file(self.kind);
        let (path, part) = (folder.join(&name), folder.join(format!(".{name}.part")));
        fs::write(&part, bytes)?;
        fs::rename(&part, &path)?;
        let mut found = labels(&folder, self.kind)?;
        found.retain(|other| other.ending == label.ending);
        found.sort_unstable_by_key(|&other| (other.version <= label.version, other));
        let n_old = found.len().saturating_sub(self.keep);
        found[..n_old].iter().try_for_each(|old| fs::remove_file(folder.join(old.file(self.kind))))?;
        Ok(path)
    }
}

/// A video in a folder of videos.
#[derive(Clone, Debug)]
pub struct VideoFile {
    /// The file's path.
    pub path: PathBuf,
    /// The goal.
    pub blueprint: BlueprintId,
    /// What the file's name says of it.
    pub label: VideoName,
}

/// Returns the videos of a kind (a file extension) in a folder, newest first, without foreign files; empty if the folder
/// cannot be read.
pub fn videos(folder: &Path, kind: &str) -> Vec<VideoFile> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let Some(blueprint) = entry.file_name().to_str().and_then(|name| name.parse::<BlueprintId>().ok()) else {
            continue;
        };
        for label in labels(&entry.path(), kind).unwrap_or_default() {
            found.push(VideoFile { path: entry.path().join(label.file(kind)), blueprint: blueprint.clone(), label });
        }
    }
    found.sort_by_key(|VideoFile { blueprint, label, .. }| {
        (std::cmp::Reverse(label.version), blueprint.clone(), label.ending.name())
    });
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn label(version: u64, ending: Ending) -> VideoName {
        VideoName { version: WeightsVersion(version), ending }
    }

    #[test]
    fn clip_name_round_trips_and_foreign_names_are_rejected() {
        for expected in [label(7, Ending::Success), label(123_456_789, Ending::Failure)] {
            assert_eq!(VideoName::of(&format!("{}.mp4", expected.name()), "mp4"), Some(expected));
        }
        assert_eq!(label(7, Ending::Success).name(), "00000007-success");
        for foreign in ["7-success", "00000007-best", "00000007-success-1", "mine", "00000007"] {
            assert_eq!(VideoName::of(&format!("{foreign}.mp4"), "mp4"), None, "{foreign}");
        }
    }

    #[test]
    fn newest_clips_of_each_ending_and_foreign_files_stay() {
        let dir = tempfile::tempdir().unwrap();
        let store = VideoStore { folder: dir.path().to_owned(), kind: "mp4", keep: 2 };
        let blueprint = BlueprintId::try_from("2_000".to_owned()).unwrap();
        let folder = dir.path().join("2_000");
        fs::create_dir(&folder).unwrap();
        for foreign in ["mine.mp4", "1-success.mp4", "00000001-success.txt"] {
            fs::write(folder.join(foreign), "").unwrap();
        }
        for version in [1, 2, 3] {
            store.put(&blueprint, label(version, Ending::Success), b"video").unwrap();
        }
        store.put(&blueprint, label(1, Ending::Failure), b"video").unwrap();
        let mut names: Vec<String> =
            fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        let kept = ["00000001-failure.mp4", "00000001-success.txt", "00000002-success.mp4", "00000003-success.mp4"];
        assert_eq!(names, [&kept[..], &["1-success.mp4", "mine.mp4"]].concat());
        // The page shows only our own videos, newest first.
        let shown: Vec<_> = videos(dir.path(), "mp4").into_iter().map(|video| video.label).collect();
        let expected = [(3, Ending::Success), (2, Ending::Success), (1, Ending::Failure)];
        assert_eq!(shown, expected.map(|(version, ending)| label(version, ending)));
        assert!(videos(&dir.path().join("nowhere"), "mp4").is_empty());
    }

    #[test]
    fn after_a_return_to_an_older_checkpoint_new_clips_replace_abandoned_ones() {
        let dir = tempfile::tempdir().unwrap();
        let store = VideoStore { folder: dir.path().to_owned(), kind: "mp4", keep: 2 };
        let blueprint = BlueprintId::try_from("2_000".to_owned()).unwrap();
        let kept = |version| {
            store.put(&blueprint, label(version, Ending::Success), b"video").unwrap();
            videos(dir.path(), "mp4").into_iter().map(|video| video.label.version.0).collect::<Vec<_>>()
        };
        assert_eq!([700, 800, 301, 302].map(kept), [vec![700], vec![800, 700], vec![800, 301], vec![302, 301]]);
    }
}

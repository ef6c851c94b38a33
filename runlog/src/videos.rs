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
    /// Number among videos of the same version and ending, from 1; the file name omits a 1.
    pub number: u32,
}

impl VideoName {
    /// Returns the file name without the extension; the names of a blueprint sort by version.
    pub fn name(&self) -> String {
        let version = self.version.0;
        let ending = self.ending.name();
        match self.number {
            0 | 1 => format!("{version:08}-{ending}"),
            number => format!("{version:08}-{ending}-{number}"),
        }
    }

    /// Parses a [`name`](Self::name) with the extension `kind`; returns `None` for foreign files.
    fn of(file: &str, kind: &str) -> Option<Self> {
        let name = file.strip_suffix(kind)?.strip_suffix('.')?;
        let mut parts = name.splitn(3, '-');
        let version = WeightsVersion(parts.next()?.parse().ok()?);
        let ending = parts.next()?;
        let ending = Ending::ALL.into_iter().find(|known| known.name() == ending)?;
        let number = parts.next().map_or(Some(1), |number| number.parse().ok())?;
        let label = Self { version, ending, number };
        (label.name() == name).then_some(label)
    }
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
        let name = label.name();
        let kind = self.kind;
        let (path, part) = (folder.join(format!("{name}.{kind}")), folder.join(format!(".{name}.{kind}.part")));
        fs::write(&part, bytes)?;
        fs::rename(&part, &path)?;
        self.remove_old(&folder, label)?;
        Ok(path)
    }

    fn remove_old(&self, folder: &Path, newest: VideoName) -> io::Result<()> {
        let mut found = Vec::new();
        for entry in fs::read_dir(folder)? {
            let name = entry?.file_name();
            let label = name.to_str().and_then(|name| VideoName::of(name, self.kind));
            found.extend(label.filter(|label| label.ending == newest.ending));
        }
        found.sort_unstable_by_key(|&label| (label.version <= newest.version, label));
        let n_old = found.len().saturating_sub(self.keep);
        found[..n_old]
            .iter()
            .try_for_each(|label| fs::remove_file(folder.join(format!("{}.{}", label.name(), self.kind))))
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
    let names = |folder: &Path| {
        let entries = fs::read_dir(folder).into_iter().flatten().flatten();
        entries.filter_map(|entry| entry.file_name().into_string().ok()).collect::<Vec<_>>()
    };
    let mut found = Vec::new();
    for blueprint in names(folder).into_iter().filter_map(|name| BlueprintId::try_from(name).ok()) {
        let own = folder.join(blueprint.as_str());
        for name in names(&own) {
            let Some(label) = VideoName::of(&name, kind) else { continue };
            found.push(VideoFile { path: own.join(&name), blueprint: blueprint.clone(), label });
        }
    }
    found.sort_by_key(|VideoFile { blueprint, label, .. }| {
        (std::cmp::Reverse(label.version), blueprint.clone(), label.ending.name(), label.number)
    });
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn label(version: u64, ending: Ending, number: u32) -> VideoName {
        VideoName { version: WeightsVersion(version), ending, number }
    }

    #[test]
    fn clip_name_round_trips_and_foreign_names_are_rejected() {
        for expected in [label(7, Ending::Success, 1), label(123_456_789, Ending::Failure, 3)] {
            assert_eq!(VideoName::of(&format!("{}.mp4", expected.name()), "mp4"), Some(expected));
        }
        assert_eq!(label(7, Ending::Success, 1).name(), "00000007-success");
        for foreign in ["7-success", "00000007-best", "00000007-success-1", "00000007-success-x", "mine", "00000007"] {
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
            store.put(&blueprint, label(version, Ending::Success, 1), b"video").unwrap();
        }
        store.put(&blueprint, label(1, Ending::Failure, 1), b"video").unwrap();
        let mut names: Vec<String> =
            fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        let kept = ["00000001-failure.mp4", "00000001-success.txt", "00000002-success.mp4", "00000003-success.mp4"];
        assert_eq!(names, [&kept[..], &["1-success.mp4", "mine.mp4"]].concat());
        // The page shows only our own videos, newest first.
        let shown: Vec<_> = videos(dir.path(), "mp4").into_iter().map(|video| video.label).collect();
        let expected = [(3, Ending::Success), (2, Ending::Success), (1, Ending::Failure)];
        assert_eq!(shown, expected.map(|(version, ending)| label(version, ending, 1)));
        assert!(videos(&dir.path().join("nowhere"), "mp4").is_empty());
    }

    #[test]
    fn after_a_return_to_an_older_checkpoint_new_clips_replace_abandoned_ones() {
        let dir = tempfile::tempdir().unwrap();
        let store = VideoStore { folder: dir.path().to_owned(), kind: "mp4", keep: 2 };
        let blueprint = BlueprintId::try_from("2_000".to_owned()).unwrap();
        let kept = |version| {
            store.put(&blueprint, label(version, Ending::Success, 1), b"video").unwrap();
            videos(dir.path(), "mp4").into_iter().map(|video| video.label.version.0).collect::<Vec<_>>()
        };
        assert_eq!([700, 800, 301, 302].map(kept), [vec![700], vec![800, 700], vec![800, 301], vec![302, 301]]);
    }
}

//! Reads episodes from files of recorded trajectories.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use blueprints::BlueprintId;
use proto::codec::{MAX_TRAJECTORY_BYTES, decode_trajectory};
use proto::{DecodeError, Trajectory};
use render::video::{Episode, is_same_episode};
use runlog::RunPaths;

use super::{Goals, Named};
use crate::exit::Failure;

/// The first bytes of every trajectory: field 1 (the protocol version) is 1, and field 2 (the actor's name) follows.
const BEGINNING: [u8; 3] = [0x08, 0x01, 0x12];

/// File extension of recordings.
const KIND: &str = "trajectory";

/// The segments of one episode and the files that they come from.
struct Recording {
    name: String,
    files: Vec<PathBuf>,
    segments: Vec<Trajectory>,
}

/// Reads the episodes of all files, and of all recordings in run folders.
pub(super) fn read_all(paths: &[PathBuf], goals: &Goals) -> Result<Vec<Named>, Failure> {
    let mut recordings: Vec<Recording> = Vec::new();
    for path in paths {
        if path.is_dir() {
            for (name, path) in of_run(path)? {
                // Each file is a complete episode. Episodes of one blueprint from several evaluations differ only in
                // their weights.
                let segments = vec![read(&path)?];
                recordings.push(Recording { name, files: vec![path], segments });
            }
            continue;
        }
        let segment = read(path)?;
        match recordings.iter_mut().find(|known| is_same_episode(&known.segments[0], &segment)) {
            Some(known) => {
                known.files.push(path.clone());
                known.segments.push(segment);
            }
            None => {
                let stem =
                    path.file_stem().map_or_else(|| "film".to_owned(), |stem| stem.to_string_lossy().into_owned());
                recordings.push(Recording { name: stem, files: vec![path.clone()], segments: vec![segment] });
            }
        }
    }
    recordings.retain(|recording| goals.are_shown(&recording.segments[0].task.blueprint));
    if recordings.is_empty() {
        let chosen: Vec<&str> = goals.chosen.iter().map(BlueprintId::as_str).collect();
        return Err(Failure::NothingToShow(format!("no recorded episode has the goal {}", chosen.join(" or "))));
    }
    let episodes: Vec<Named> =
        recordings.into_iter().map(|recording| recording.episode(goals)).collect::<Result<_, _>>()?;
    if let Some(i) = (1..episodes.len()).find(|&i| episodes[..i].iter().any(|(name, _)| *name == episodes[i].0)) {
        return Err(Failure::Usage(format!("two recordings would become {}; rename one of the files", episodes[i].0)));
    }
    Ok(episodes)
}

/// The files of all recordings of a run with names for their films, ordered by blueprint and weights version.
fn of_run(run: &Path) -> Result<Vec<(String, PathBuf)>, Failure> {
    let replays = RunPaths::new(run).replays();
    let nothing = |reason: &str| {
        Failure::NothingToShow(format!("{}: {reason}; an evaluator with a run directory records some", run.display()))
    };
    if !replays.is_dir() {
        return Err(nothing("no folder of a run with recordings"));
    }
    let refused = |error: io::Error| Failure::Recording {
        files: replays.display().to_string(),
        reason: format!("cannot be read: {error}"),
    };
    let mut found = Vec::new();
    for folder in sorted(&replays).map_err(refused)?.into_iter().filter(|path| path.is_dir()) {
        for path in sorted(&folder).map_err(refused)? {
            if path.extension().is_some_and(|kind| kind == KIND)
                && let (Some(blueprint), Some(stem)) = (folder.file_name(), path.file_stem())
            {
                found.push((format!("{}-{}", blueprint.display(), stem.display()), path));
            }
        }
    }
    if found.is_empty() { Err(nothing("no recordings yet")) } else { Ok(found) }
}

fn sorted(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let mut paths: Vec<PathBuf> = fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect::<io::Result<_>>()?;
    paths.sort();
    Ok(paths)
}

impl Recording {
    fn episode(self, goals: &Goals) -> Result<Named, Failure> {
        let refused = |reason: String| {
            let files: Vec<String> = self.files.iter().map(|path| path.display().to_string()).collect();
            Failure::Recording { files: files.join(", "), reason }
        };
        let goal = goals.find(&self.segments[0].task.blueprint).map_err(refused)?;
        let episode = Episode::new(&self.segments, &goal).map_err(|error| refused(error.to_string()))?;
        Ok((self.name, episode))
    }
}

fn read(path: &Path) -> Result<Trajectory, Failure> {
    let mut bytes = Vec::new();
    // One byte more than the limit is enough for the decoder to reject the file.
    let read = File::open(path).and_then(|file| file.take(MAX_TRAJECTORY_BYTES as u64 + 1).read_to_end(&mut bytes));
    let refused = |reason: String| Failure::Recording { files: path.display().to_string(), reason };
    read.map_err(|error| refused(format!("cannot be read: {error}")))?;
    decode_trajectory(&bytes).map_err(|error| refused(explained(&bytes, &error)))
}

/// Describes what is wrong with a file that is not a valid trajectory.
fn explained(bytes: &[u8], error: &DecodeError) -> String {
    let is_broken = matches!(error, DecodeError::Malformed { .. } | DecodeError::Missing { .. });
    match (bytes.is_empty(), bytes.starts_with(&BEGINNING)) {
        (true, _) => "is empty".to_owned(),
        // The decoder's message would not help a user.
        (_, true) if is_broken => {
            "begins like a recorded trajectory but is cut off or damaged: record it again".to_owned()
        }
        (_, true) => format!("is no valid trajectory: {error}"),
        (_, false) => format!("is not a recorded trajectory: {error}"),
    }
}

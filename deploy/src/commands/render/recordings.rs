//! The episodes to show, and how to read them from files of recorded trajectories.

use std::ffi::{OsStr, OsString};
use std::fs;
use std::path::{Path, PathBuf};

use blueprints::{Blueprint, BlueprintId, outside};
use proto::codec::{MAX_RECORDING_BYTES, PROTOCOL_VERSION, decode_recording};
use proto::{DecodeError, Trajectory};
use render::video::{Episode, is_same_episode};
use runlog::RunPaths;
use runlog::videos::{RECORDING, VideoFile, videos};

use crate::cli::RenderArgs;
use crate::commands::goals::Goals;
use crate::config::nearest;
use crate::exit::Failure;
use crate::run_dir::check_exists;

/// The name of a video and its episode.
pub(super) type Named = (OsString, Episode);

/// The goals of the episodes. Those that are named are shown; if there are none, all.
pub(super) fn goals_of(args: &RenderArgs) -> Result<Goals, Failure> {
    Goals::open_beside(&args.blueprint, args.files.first().map(PathBuf::as_path))
}

fn is_shown(goals: &Goals, id: &BlueprintId) -> bool {
    goals.ids.is_empty() || goals.ids.contains(id)
}

/// Finds the blueprint, or explains why it is missing.
fn goal_of<'g>(segment: &Trajectory, goals: &'g Goals) -> Result<&'g Blueprint, String> {
    let (id, catalog) = (&segment.task.blueprint, &goals.catalog);
    catalog.get(id).ok_or_else(|| {
        let known = nearest(id.as_str(), catalog.iter().map(|blueprint| blueprint.id().as_str()));
        let like = known.map_or_else(String::new, |known| format!(" (it has `{known}`)"));
        format!("its goal `{id}` is not in the catalog{like}; name its file with --blueprint")
    })
}

/// The segments of one episode and the files that they come from.
pub(super) struct Recording {
    pub(super) name: OsString,
    pub(super) files: Vec<PathBuf>,
    pub(super) segments: Vec<Trajectory>,
}

/// Reads the episodes of all files, and of all recordings in run folders.
pub(super) fn read_all(paths: &[PathBuf], goals: &Goals) -> Result<Vec<Named>, Failure> {
    let mut recordings: Vec<Recording> = Vec::new();
    for path in paths {
        check_exists(path)?;
        if path.is_dir() {
            for (name, path) in of_run(path)? {
                // Each file is a complete episode. Episodes of one blueprint from several evaluations differ only in
                // their weights.
                let segments = vec![read(&path)?];
                recordings.push(Recording { name, files: vec![path], segments });
            }
            continue;
        }
        add(&mut recordings, path, read(path)?);
    }
    recordings.retain(|recording| is_shown(goals, &recording.segments[0].task.blueprint));
    if recordings.is_empty() {
        let chosen: Vec<&str> = goals.ids.iter().map(BlueprintId::as_str).collect();
        return Err(Failure::NothingToShow(format!("no recorded episode has the goal {}", chosen.join(" or "))));
    }
    let episodes: Vec<Named> =
        recordings.into_iter().map(|recording| recording.episode(goals)).collect::<Result<_, _>>()?;
    if let Some(i) = (1..episodes.len()).find(|&i| episodes[..i].iter().any(|(name, _)| *name == episodes[i].0)) {
        return Err(Failure::Usage(format!(
            "two recordings would become {}; rename one of the files",
            episodes[i].0.display()
        )));
    }
    Ok(episodes)
}

/// Adds a segment to the recording of its episode, or starts one.
fn add(recordings: &mut Vec<Recording>, path: &Path, segment: Trajectory) {
    let steps = |segment: &Trajectory| {
        let first = usize::from(segment.first_step);
        (first, first + segment.transitions.len())
    };
    let (first, end) = steps(&segment);
    // Episodes of one blueprint from several evaluations pass for the same, but no episode has a step twice.
    let is_new = |other: &Trajectory| end <= steps(other).0 || steps(other).1 <= first;
    let continues =
        |known: &&mut Recording| is_same_episode(&known.segments[0], &segment) && known.segments.iter().all(is_new);
    match recordings.iter_mut().find(continues) {
        Some(known) => {
            known.files.push(path.to_owned());
            known.segments.push(segment);
        }
        None => {
            let name = path.file_stem().unwrap_or(OsStr::new("video")).to_owned();
            recordings.push(Recording { name, files: vec![path.to_owned()], segments: vec![segment] });
        }
    }
}

/// The files of all recordings of a run with names for their videos, ordered by blueprint and weights version.
fn of_run(run: &Path) -> Result<Vec<(OsString, PathBuf)>, Failure> {
    let replays = RunPaths::new(run).replays();
    let nothing = |reason: &str| {
        Failure::NothingToShow(format!("{}: {reason}; an evaluator with a run directory records some", run.display()))
    };
    if fs::read_dir(&replays).is_err() {
        return Err(nothing("no folder of a run with recordings that can be read"));
    }
    let named = |VideoFile { path, blueprint, label }| (format!("{blueprint}-{}", label.name()).into(), path);
    let mut found: Vec<(OsString, PathBuf)> = videos(&replays, RECORDING).into_iter().map(named).collect();
    found.sort();
    if found.is_empty() { Err(nothing("no recordings yet")) } else { Ok(found) }
}

impl Recording {
    pub(super) fn episode(self, goals: &Goals) -> Result<Named, Failure> {
        let refused = |reason: String| {
            let files: Vec<String> = self.files.iter().map(|path| path.display().to_string()).collect();
            Failure::Input(format!("{}: {reason}", files.join(", ")))
        };
        let goal = goal_of(&self.segments[0], goals).map_err(refused)?;
        let episode = Episode::new(&self.segments, goal).map_err(|error| refused(error.to_string()))?;
        Ok((self.name, episode))
    }
}

fn read(path: &Path) -> Result<Trajectory, Failure> {
    let refused = |reason: String| Failure::Input(format!("{}: {reason}", path.display()));
    let read = outside::read(path, MAX_RECORDING_BYTES as u64);
    let bytes = read.map_err(|error| refused(format!("cannot be read: {error}")))?;
    decode_recording(&bytes).map_err(|error| refused(explained(&bytes, &error)))
}

/// Describes what is wrong with a file that is not a valid trajectory.
fn explained(bytes: &[u8], error: &DecodeError) -> String {
    let is_broken =
        matches!(error, DecodeError::Malformed { .. } | DecodeError::Missing { .. } | DecodeError::Checksum { .. });
    match (bytes.is_empty(), begins_like_one(bytes)) {
        (true, _) => "is empty".to_owned(),
        // The decoder's message would not help a user.
        (_, true) if is_broken => {
            "begins like a recorded trajectory but is cut off or damaged: record it again".to_owned()
        }
        (_, true) => format!("is no valid trajectory: {error}"),
        (_, false) => format!("is not a recorded trajectory: {error}"),
    }
}

/// Whether field 1 (the protocol version) is a known one, and field 2 (the actor's name) follows.
fn begins_like_one(bytes: &[u8]) -> bool {
    matches!(bytes, [0x08, version, 0x12, ..] if (1..=PROTOCOL_VERSION).contains(&u32::from(*version)))
}

#[cfg(test)]
mod tests {
    use proto::Status;

    use super::*;

    /// Steps `first` to `last` of an episode with the start that this blueprint has in every evaluation.
    fn segment(first: u16, last: u16) -> Trajectory {
        let golden = "../tests/golden/run-0.1.0/replays/2_000/00000000-failure.trajectory";
        let bytes = fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join(golden)).unwrap();
        let mut segment = decode_recording(&bytes).unwrap();
        segment.first_step = first;
        segment.transitions.truncate(usize::from(last - first));
        (segment.status, segment.episode_stats) = (Status::Running, None);
        segment
    }

    #[test]
    fn recordings_of_one_blueprint_are_episodes_of_their_own_and_segments_are_joined() {
        let mut recordings = Vec::new();
        for (name, first, last) in [("v1", 0, 4), ("v2", 0, 3), ("v2-end", 3, 6), ("v1-end", 4, 5), ("v3", 0, 5)] {
            add(&mut recordings, Path::new(&format!("replays/2_000/{name}.trajectory")), segment(first, last));
        }
        let goals = Goals::open_beside(&[], None).unwrap();
        let lengths: Vec<(OsString, usize)> = recordings
            .into_iter()
            .map(|recording| recording.episode(&goals).unwrap())
            .map(|(name, episode)| (name, episode.n_steps()))
            .collect();
        let expected = [("v1", 5), ("v2", 6), ("v3", 5)].map(|(name, n_steps)| (name.into(), n_steps));
        assert_eq!(lengths, expected);
    }
}

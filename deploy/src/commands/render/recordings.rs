//! The episodes to show, and how to read them from files of recorded trajectories.

use std::ffi::{OsStr, OsString};
use std::fs;
use std::path::{Path, PathBuf};

use blueprints::{Blueprint, BlueprintId, outside};
use proto::codec::{MAX_RECORDING_BYTES, PROTOCOL_VERSION, decode_recording};
use proto::{DecodeError, Trajectory};
use render::video::Episode;
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
fn goal_of<'g>(recording: &Trajectory, goals: &'g Goals) -> Result<&'g Blueprint, String> {
    let (id, catalog) = (&recording.task.blueprint, &goals.catalog);
    catalog.get(id).ok_or_else(|| {
        let known = nearest(id.as_str(), catalog.iter().map(|blueprint| blueprint.id().as_str()));
        let like = known.map_or_else(String::new, |known| format!(" (it has `{known}`)"));
        format!("its goal `{id}` is not in the catalog{like}; name its file with --blueprint")
    })
}

/// Reads the episodes of all files, and of all recordings in run folders.
pub(super) fn read_all(paths: &[PathBuf], goals: &Goals) -> Result<Vec<Named>, Failure> {
    let mut files = Vec::new();
    for path in paths {
        check_exists(path)?;
        if path.is_dir() {
            files.extend(of_run(path)?);
        } else {
            files.push((path.file_stem().unwrap_or(OsStr::new("video")).to_owned(), path.clone()));
        }
    }
    let mut episodes: Vec<Named> = Vec::new();
    for (name, path) in files {
        let refused = |reason: String| Failure::Input(format!("{}: {reason}", path.display()));
        let recording = read(&path).map_err(refused)?;
        if !is_shown(goals, &recording.task.blueprint) {
            continue;
        }
        if episodes.iter().any(|(other, _)| *other == name) {
            let name = name.display();
            return Err(Failure::Usage(format!("two recordings would become {name}; rename one of the files")));
        }
        let goal = goal_of(&recording, goals).map_err(refused)?;
        let episode = Episode::new(&recording, goal).map_err(|error| refused(error.to_string()))?;
        episodes.push((name, episode));
    }
    if episodes.is_empty() {
        let chosen: Vec<&str> = goals.ids.iter().map(BlueprintId::as_str).collect();
        return Err(Failure::NothingToShow(format!("no recorded episode has the goal {}", chosen.join(" or "))));
    }
    Ok(episodes)
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

fn read(path: &Path) -> Result<Trajectory, String> {
    let read = outside::read(path, MAX_RECORDING_BYTES as u64);
    let bytes = read.map_err(|error| format!("cannot be read: {error}"))?;
    decode_recording(&bytes).map_err(|error| explained(&bytes, &error))
}

/// Describes what is wrong with a file that is not a valid trajectory.
fn explained(bytes: &[u8], error: &DecodeError) -> String {
    let is_broken = !matches!(error, DecodeError::Invalid(_));
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

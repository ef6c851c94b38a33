//! `render`: films of recorded trajectories.

use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};

use anyhow::Context;
use blueprints::Catalogue;
use evaluator::picture::encode;
use evaluator::video::{Episode, Film, gif, is_same_episode, mp4, strip};
use proto::codec::{MAX_TRAJECTORY_BYTES, decode_trajectory};
use proto::{DecodeError, Trajectory};

use crate::cli::{FilmFormat, RenderArgs};
use crate::config::nearest;
use crate::exit::Failure;
use crate::live::Terminal;

/// Scenes in a strip beside the goal: two full rows.
const N_STRIP_SCENES: usize = 7;

/// Colours of a strip, which is to be small enough to keep in a repository.
const STRIP_COLORS: usize = 96;

/// The first bytes of every trajectory: field 1 (the protocol version) is 1, field 2 (the actor's name) follows.
const BEGINNING: [u8; 3] = [0x08, 0x01, 0x12];

/// Segments of one episode and the files that they come from.
struct Recording {
    files: Vec<PathBuf>,
    segments: Vec<Trajectory>,
}

/// Runs the subcommand. Every file is read before the first film is made.
///
/// # Errors
/// When a file is no recording or its goal is unknown, or a film cannot be made or written.
pub(super) fn run(args: &RenderArgs, terminal: &Terminal) -> Result<(), Failure> {
    let loaded = args.path.as_deref().map(Catalogue::load).transpose()?;
    let catalogue = loaded.as_ref().unwrap_or_else(|| Catalogue::builtin());
    let mut recordings: Vec<Recording> = Vec::new();
    for path in &args.files {
        let segment = read(path)?;
        match recordings.iter_mut().find(|known| is_same_episode(&known.segments[0], &segment)) {
            Some(known) => {
                known.files.push(path.clone());
                known.segments.push(segment);
            }
            None => recordings.push(Recording { files: vec![path.clone()], segments: vec![segment] }),
        }
    }
    let episodes: Vec<(String, Episode)> =
        recordings.iter().map(|recording| recording.episode(catalogue)).collect::<Result<_, _>>()?;
    if let Some(i) = (1..episodes.len()).find(|&i| episodes[..i].iter().any(|(name, _)| *name == episodes[i].0)) {
        return Err(Failure::Usage(format!("two recordings would become {}; rename one of the files", episodes[i].0)));
    }
    fs::create_dir_all(&args.out).with_context(|| format!("cannot create {}", args.out.display()))?;
    for (name, episode) in &episodes {
        let (ending, bytes) = make(episode, args).with_context(|| format!("making a film of {name}"))?;
        let path = args.out.join(format!("{name}.{ending}"));
        let part = args.out.join(format!(".{name}.{ending}.part"));
        fs::write(&part, &bytes)
            .and_then(|()| fs::rename(&part, &path))
            .with_context(|| format!("cannot write {}", path.display()))?;
        terminal.print(&format!("{}: {} steps, {} kB", path.display(), episode.n_steps(), bytes.len().div_ceil(1000)));
    }
    Ok(())
}

/// The ending of the file's name, and its bytes.
fn make(episode: &Episode, args: &RenderArgs) -> anyhow::Result<(&'static str, Vec<u8>)> {
    Ok(match args.format {
        FilmFormat::Mp4 => {
            let fps = args.fps.unwrap_or(30);
            ("mp4", mp4(Film::new(episode, args.width.unwrap_or(960)).frames(fps), fps)?)
        }
        FilmFormat::Gif => {
            let fps = args.fps.unwrap_or(10);
            ("gif", gif(Film::new(episode, args.width.unwrap_or(640)).frames(fps), fps)?)
        }
        FilmFormat::PngStrip => {
            ("png", encode(&strip(episode, N_STRIP_SCENES, args.width.unwrap_or(1200)), STRIP_COLORS)?)
        }
    })
}

impl Recording {
    /// A name for the film, that of the first file, and the episode.
    fn episode(&self, catalogue: &Catalogue) -> Result<(String, Episode), Failure> {
        let refused = |reason: String| {
            let files: Vec<String> = self.files.iter().map(|path| path.display().to_string()).collect();
            Failure::Recording { files: files.join(", "), reason }
        };
        let id = &self.segments[0].task.blueprint;
        let goal = catalogue.find(id).ok_or_else(|| {
            let known = nearest(id.as_str(), catalogue.iter().map(|blueprint| blueprint.id().as_str()));
            let like = known.map_or_else(String::new, |known| format!(" (it has `{known}`)"));
            refused(format!("its goal `{id}` is not in the catalogue{like}; --path names another one"))
        })?;
        let episode = Episode::new(&self.segments, &goal).map_err(|error| refused(error.to_string()))?;
        let name =
            self.files[0].file_stem().map_or_else(|| "film".to_owned(), |stem| stem.to_string_lossy().into_owned());
        Ok((name, episode))
    }
}

fn read(path: &Path) -> Result<Trajectory, Failure> {
    let mut bytes = Vec::new();
    // One byte more than allowed is enough for the decoder to refuse it.
    let read = File::open(path).and_then(|file| file.take(MAX_TRAJECTORY_BYTES as u64 + 1).read_to_end(&mut bytes));
    let refused = |reason: String| Failure::Recording { files: path.display().to_string(), reason };
    read.map_err(|error| refused(format!("cannot be read: {error}")))?;
    decode_trajectory(&bytes).map_err(|error| refused(explained(&bytes, &error)))
}

/// What is wrong with a file that is no trajectory.
fn explained(bytes: &[u8], error: &DecodeError) -> String {
    let is_broken = matches!(error, DecodeError::Malformed { .. } | DecodeError::Missing { .. });
    match (bytes.is_empty(), bytes.starts_with(&BEGINNING)) {
        (true, _) => "is empty".to_owned(),
        (_, true) if is_broken => format!("begins like a recorded trajectory but is cut off or damaged: {error}"),
        (_, true) => format!("is no valid trajectory: {error}"),
        (_, false) => format!("is not a recorded trajectory: {error}"),
    }
}

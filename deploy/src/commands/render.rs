//! `render`: makes videos of recorded trajectories, of a run's recordings, and of the episodes of running actors.

mod live;
mod recordings;
mod shares;

use std::borrow::Cow;
use std::ffi::{OsStr, OsString};
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Context;
use blueprints::{Blueprint, BlueprintId, Catalog};
use evaluator::{Policy, PolicyError};
use render::picture::encode;
use render::video::{AttentionVideo, Episode, EpisodeAttention, Video, attention_strip, gif, mp4, strip};

use super::files::write_files;
use super::goals;
use super::models::Source;
use crate::cli::{RenderArgs, VideoFormat};
use crate::config::nearest;
use crate::exit::Failure;
use crate::live::Terminal;

pub(super) use live::run as run_live;

/// Scenes in a strip, which fill two rows together with the goal, and scenes in an attention strip.
const N_STRIP_SCENES: usize = 7;
const N_STRIP_MOMENTS: usize = 5;

/// Palette size of a strip, which should be small enough to keep in a repository.
const STRIP_COLORS: usize = 96;

/// The name of a video and its episode.
type Named = (OsString, Episode);

/// Runs the subcommand. Reads every file before it makes the first video.
///
/// # Errors
/// When a file is not a recording, its goal is unknown, or a video cannot be made or written.
pub(super) fn run(args: &RenderArgs, terminal: &Terminal) -> Result<(), Failure> {
    let goals = Goals::new(args)?;
    let policy = policy(args)?;
    let episodes = recordings::read_all(&args.files, &goals)?;
    if let Some(policy) = policy.as_ref().filter(|_| args.table) {
        return shares::write(&episodes, policy, args, terminal);
    }
    make_all(&episodes, args, policy.as_ref(), terminal)
}

/// The catalog of goals, and the goals to show.
struct Goals {
    catalog: Arc<Catalog>,
    /// The named goals; if empty, all are shown.
    chosen: Vec<BlueprintId>,
}

impl Goals {
    fn new(args: &RenderArgs) -> Result<Self, Failure> {
        if let Some(path) = &args.path {
            return Ok(Self { catalog: Arc::new(Catalog::load(path)?), chosen: Vec::new() });
        }
        let goals = goals::Goals::open_beside(&args.blueprint, args.files.first().map(PathBuf::as_path))?;
        let chosen = goals.ids().to_vec();
        Ok(Self { catalog: goals.catalog().clone(), chosen })
    }

    /// Whether episodes with this goal are shown.
    fn are_shown(&self, id: &BlueprintId) -> bool {
        self.chosen.is_empty() || self.chosen.contains(id)
    }

    /// Finds the blueprint, or explains why it is missing.
    fn find(&self, id: &BlueprintId) -> Result<Cow<'_, Blueprint>, String> {
        let catalog = &self.catalog;
        catalog.find(id).ok_or_else(|| {
            let known = nearest(id.as_str(), catalog.iter().map(|blueprint| blueprint.id().as_str()));
            let like = known.map_or_else(String::new, |known| format!(" (it has `{known}`)"));
            format!("its goal `{id}` is not in the catalog{like}; name its file with --blueprint")
        })
    }
}

/// The policy whose attention is shown.
fn policy(args: &RenderArgs) -> Result<Option<Policy>, Failure> {
    let Some(path) = &args.attention else { return Ok(None) };
    let model = Source::read(path)?.model;
    let refused =
        |error: PolicyError| Failure::Checkpoint(anyhow::Error::new(error).context(path.display().to_string()));
    let mut policy = Policy::new(&model.policy);
    policy.load(&model.weights).map_err(refused)?;
    Ok(Some(policy))
}

fn make_all(
    episodes: &[Named],
    args: &RenderArgs,
    policy: Option<&Policy>,
    terminal: &Terminal,
) -> Result<(), Failure> {
    for (name, episode) in episodes {
        let making = || format!("making a video of {}", name.display());
        let (ending, bytes) = match policy {
            Some(policy) => make_of_attention(&attention(policy, name, episode)?, args).with_context(making)?,
            None => make(episode, args).with_context(making)?,
        };
        let n_bytes = bytes.len();
        let mut name = name.clone();
        name.push(format!("{}.{ending}", if policy.is_some() { "-attention" } else { "" }));
        let path = args.out.join(&name);
        write_files(&args.out, &[(name, bytes)])?;
        terminal.print(&format!("{}: {} steps, {} kB", path.display(), episode.n_steps(), n_bytes.div_ceil(1000)));
    }
    Ok(())
}

fn attention<'e>(policy: &Policy, name: &OsStr, episode: &'e Episode) -> Result<EpisodeAttention<'e>, Failure> {
    EpisodeAttention::new(policy, episode)
        .map_err(|error| Failure::Recording { files: name.display().to_string(), reason: error.to_string() })
}

/// Renders an episode. Returns the extension of the file name and the file's bytes.
fn make(episode: &Episode, args: &RenderArgs) -> anyhow::Result<(&'static str, Vec<u8>)> {
    Ok(match args.format {
        VideoFormat::Mp4 => {
            let fps = args.fps.unwrap_or(30);
            ("mp4", mp4(Video::new(episode, args.width.unwrap_or(960)).frames(fps), fps)?)
        }
        VideoFormat::Gif => {
            let fps = args.fps.unwrap_or(10);
            ("gif", gif(Video::new(episode, args.width.unwrap_or(640)).frames(fps), fps)?)
        }
        VideoFormat::PngStrip => {
            ("png", encode(&strip(episode, N_STRIP_SCENES, args.width.unwrap_or(1200)), STRIP_COLORS)?)
        }
    })
}

/// Like [`make`], for a video of what a network attends to.
fn make_of_attention(attention: &EpisodeAttention<'_>, args: &RenderArgs) -> anyhow::Result<(&'static str, Vec<u8>)> {
    // Attention changes only once per step, so a higher frame rate would show nothing more.
    let (width, fps) = (args.width.unwrap_or(1280), args.fps.unwrap_or(10));
    Ok(match args.format {
        VideoFormat::Mp4 => ("mp4", mp4(AttentionVideo::new(attention, width).frames(fps), fps)?),
        VideoFormat::Gif => ("gif", gif(AttentionVideo::new(attention, width).frames(fps), fps)?),
        VideoFormat::PngStrip => ("png", encode(&attention_strip(attention, N_STRIP_MOMENTS, width), STRIP_COLORS)?),
    })
}

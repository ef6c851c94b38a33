//! `render`: makes videos of recorded trajectories, and of a run's recordings.

mod recordings;
mod shares;

use anyhow::Context;
use evaluator::Policy;
use render::picture::encode;
use render::video::{AttentionVideo, Episode, EpisodeAttention, Video, attention_strip, gif, mp4, strip};

use super::files::write_file;
use super::models::Source;
use crate::cli::{RenderArgs, VideoFormat};
use crate::exit::Failure;
use crate::live::Terminal;

use shares::attention;

/// Palette size of a strip, which should be small enough to keep in a repository.
const STRIP_COLORS: usize = 96;

/// Runs the subcommand. Reads every file before it makes the first video.
pub(super) fn run(args: &RenderArgs, terminal: &Terminal) -> Result<(), Failure> {
    let goals = recordings::goals_of(args)?;
    let policy = policy(args)?;
    let episodes = recordings::read_all(&args.files, &goals)?;
    if let Some(policy) = policy.as_ref().filter(|_| args.table) {
        return shares::write(&episodes, policy, args, terminal);
    }
    for (name, episode) in &episodes {
        let making = || format!("making a video of {}", name.display());
        let attention = policy.as_ref().map(|policy| attention(policy, name, episode)).transpose()?;
        let (ending, bytes) = make(episode, attention.as_ref(), args).with_context(making)?;
        let mut name = name.clone();
        name.push(format!("{}.{ending}", if policy.is_some() { "-attention" } else { "" }));
        let path = args.out.join(name);
        write_file(&path, &bytes)?;
        let n_kb = bytes.len().div_ceil(1000);
        terminal.print(&format!("{}: {} steps, {n_kb} kB", path.display(), episode.n_steps()));
    }
    Ok(())
}

/// The policy whose attention is shown.
fn policy(args: &RenderArgs) -> Result<Option<Policy>, Failure> {
    let Some(path) = &args.attention else { return Ok(None) };
    let model = Source::read(path)?.model;
    let policy = Policy::with_weights(&model.policy, &model.weights);
    Ok(Some(policy.map_err(|error| Failure::Checkpoint(error.into()))?))
}

/// Renders an episode, or what a network attends to in it. Returns the extension of the file name and the file's bytes.
fn make(
    episode: &Episode,
    attention: Option<&EpisodeAttention<'_>>,
    args: &RenderArgs,
) -> anyhow::Result<(&'static str, Vec<u8>)> {
    let (width, fps) = match (attention, args.format) {
        // Attention changes only once per step, so a higher frame rate would show nothing more.
        (Some(_), _) => (1280, 10),
        (None, VideoFormat::Mp4) => (960, 30),
        (None, VideoFormat::Gif) => (640, 10),
        (None, VideoFormat::PngStrip) => (1200, 1),
    };
    let (width, fps) = (args.width.unwrap_or(width), args.fps.unwrap_or(fps));
    Ok(match (args.format, attention) {
        (VideoFormat::Mp4, None) => ("mp4", mp4(Video::new(episode, width).frames(fps), fps)?),
        (VideoFormat::Mp4, Some(of)) => ("mp4", mp4(AttentionVideo::new(of, width).frames(fps), fps)?),
        (VideoFormat::Gif, None) => ("gif", gif(Video::new(episode, width).frames(fps), fps)?),
        (VideoFormat::Gif, Some(of)) => ("gif", gif(AttentionVideo::new(of, width).frames(fps), fps)?),
        (VideoFormat::PngStrip, None) => ("png", encode(&strip(episode, width), STRIP_COLORS)?),
        (VideoFormat::PngStrip, Some(of)) => ("png", encode(&attention_strip(of, width), STRIP_COLORS)?),
    })
}

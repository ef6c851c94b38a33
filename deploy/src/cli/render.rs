//! `render`.

use std::path::PathBuf;

use clap::builder::RangedU64ValueParser;
use clap::{Args, ValueEnum};
use proto::ActorId;
use render::video::{MAX_FPS, MAX_WIDTH, MIN_WIDTH};

use super::KeysArgs;
use super::values::endpoint;

/// Arguments of `render`.
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// Recorded trajectories, for example those of `expert eval --record DIR`; segments of one episode become one film. Of
    /// the folder of a run, all recordings that its evaluator keeps.
    #[arg(value_name = "FILE_OR_RUN", required_unless_present = "connect")]
    pub files: Vec<PathBuf>,
    /// Folder for the pictures; made if it is not there.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// What to write.
    #[arg(long, value_enum, default_value_t = FilmFormat::Mp4)]
    pub format: FilmFormat,
    /// Frames per second, at most 50 of a GIF [default: 30 of an MP4, 10 of a GIF or with --attention].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_FPS)))]
    pub fps: Option<u32>,
    /// Width in pixels; odd ones are made even [default: 960 of an MP4, 640 of a GIF, 1200 of a strip, and 1280 with
    /// --attention].
    #[arg(long, value_name = "N", value_parser = RangedU64ValueParser::<usize>::new().range(MIN_WIDTH as u64..=MAX_WIDTH as u64))]
    pub width: Option<usize>,
    /// Folder of blueprint files, or one file, with the goals [default: the catalog that comes with the program].
    #[arg(long, value_name = "FILE_OR_DIR")]
    pub path: Option<PathBuf>,
    /// Only episodes with this goal: an id, a file, or a folder of files; may be repeated.
    #[arg(long, value_name = "FILE|ID", conflicts_with = "path")]
    pub blueprint: Vec<String>,
    /// Show what a network attends to through the episode, every head of every layer: that of this run's newest checkpoint,
    /// of one checkpoint, or of an exported file. Whoever acted in the episode.
    #[arg(long, value_name = "DIR")]
    pub attention: Option<PathBuf>,
    /// Print what each head attends to, in the mean over all scenes of all files, and write it to attention.csv; no films.
    #[arg(long, requires = "attention", conflicts_with_all = ["format", "fps", "width", "connect"])]
    pub table: bool,
    /// Live episodes of a run's actors.
    #[command(flatten)]
    pub live: LiveArgs,
}

/// Which episodes of running actors `render` waits for.
#[derive(Debug, Args)]
pub struct LiveArgs {
    /// Watch the actors of a running training instead: endpoint of its router; may be repeated.
    #[arg(long, value_name = "ENDPOINT", value_delimiter = ',', value_parser = endpoint, conflicts_with = "files")]
    pub connect: Vec<String>,
    /// Name of the run; processes that were not told one have their preset's.
    #[arg(long, value_name = "NAME", default_value = "quickstart", requires = "connect")]
    pub run: String,
    /// Keys, of which those of the role evaluator are used: a viewer may not see episodes.
    #[command(flatten)]
    pub keys: KeysArgs,
    /// Only this actor.
    #[arg(long, value_name = "ID", requires = "connect")]
    pub actor: Option<ActorId>,
    /// Episodes to wait for.
    #[arg(long, value_name = "N", default_value_t = 1, requires = "connect", value_parser = clap::value_parser!(u32).range(1..=100))]
    pub episodes: u32,
    /// Longest time to wait for each, seconds.
    #[arg(long, value_name = "S", default_value_t = 60, requires = "connect", value_parser = clap::value_parser!(u64).range(1..=86_400))]
    pub timeout: u64,
}

/// What an episode becomes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum FilmFormat {
    /// A film that every browser plays.
    Mp4,
    /// Moving pictures for places that play no film.
    Gif,
    /// One picture: the goal and seven scenes, or, with --attention, a row for each head.
    PngStrip,
}

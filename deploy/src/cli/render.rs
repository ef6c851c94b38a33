//! `render`.

use std::path::PathBuf;

use clap::builder::RangedU64ValueParser;
use clap::{Args, ValueEnum};
use evaluator::video::{MAX_FPS, MAX_WIDTH, MIN_WIDTH};

/// Arguments of `render`.
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// Recorded trajectories, for example those of `expert eval --record DIR`; segments of one episode become one film.
    #[arg(value_name = "FILE", required = true)]
    pub files: Vec<PathBuf>,
    /// Folder for the pictures; made if it is not there.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// What to write.
    #[arg(long, value_enum, default_value_t = FilmFormat::Mp4)]
    pub format: FilmFormat,
    /// Frames per second, at most 50 of a GIF [default: 30 of an MP4, 10 of a GIF].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_FPS)))]
    pub fps: Option<u32>,
    /// Width in pixels; odd ones are made even [default: 960 of an MP4, 640 of a GIF, 1200 of a strip].
    #[arg(long, value_name = "N", value_parser = RangedU64ValueParser::<usize>::new().range(MIN_WIDTH as u64..=MAX_WIDTH as u64))]
    pub width: Option<usize>,
    /// Folder of blueprint files, or one file, with the goals [default: the catalogue that comes with the program].
    #[arg(long, value_name = "FILE_OR_DIR")]
    pub path: Option<PathBuf>,
}

/// What an episode becomes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum FilmFormat {
    /// A film that every browser plays.
    Mp4,
    /// Moving pictures for places that play no film.
    Gif,
    /// One picture: the goal and seven scenes.
    PngStrip,
}

//! Arguments of the commands that show runs and what they recorded.

use std::ffi::OsString;
use std::path::PathBuf;

use clap::builder::RangedU64ValueParser;
use clap::{Args, ValueEnum};
use proto::ActionMode;
use render::video::{MAX_FPS, MAX_WIDTH, MIN_WIDTH};

use super::KeysArgs;
use super::values::{self, endpoint};

/// Arguments of `watch`.
#[derive(Debug, Args)]
pub struct WatchArgs {
    /// Folder of a run that trains on this machine [default: the newest in runs/].
    #[arg(value_name = "RUN", conflicts_with = "connect")]
    pub(crate) folder: Option<PathBuf>,
    /// Endpoint of the run's router, for example tcp/127.0.0.1:7447, quic/HOST:7447, tls/HOST:7447, or
    /// unixsock-stream//tmp/bus.sock; may be repeated.
    #[arg(long, value_name = "ENDPOINT", env = "LODESTONE_CONNECT", value_delimiter = ',', value_parser = endpoint)]
    pub(crate) connect: Vec<String>,
    /// Name of the run at --connect; unless set, a run is named after its preset [default: quickstart].
    #[arg(long, value_name = "NAME", env = "LODESTONE_RUN")]
    pub(crate) run: Option<String>,
    /// Keys; those of the role viewer are used.
    #[command(flatten)]
    pub(crate) keys: KeysArgs,
    /// Print the current state as text and exit, as soon as the learner or the evaluator has published something.
    #[arg(long)]
    pub(crate) once: bool,
    /// Print JSON; without --once, one line per change, at most one a second.
    #[arg(long)]
    pub(crate) json: bool,
    /// Longest time that --once waits for a router, and then for the run, in seconds.
    #[arg(long, value_name = "S", default_value_t = 30, requires = "once", value_parser = clap::value_parser!(u64).range(1..=86_400))]
    pub(crate) timeout: u64,
}

/// Arguments of `serve`.
#[derive(Debug, Args)]
pub struct ServeArgs {
    /// Folders of one or more runs, or of a sweep.
    #[arg(required = true, value_name = "RUN")]
    pub(crate) runs: Vec<PathBuf>,
    /// Address of the web page [default: 127.0.0.1 with a free port].
    #[arg(long, value_name = "ADDRESS:PORT", value_parser = values::address)]
    pub(crate) web: Option<std::net::SocketAddr>,
    /// Token that browsers must present; required for an address that other machines can reach.
    #[arg(long, value_name = "TOKEN")]
    pub(crate) token: Option<String>,
    /// Instead of serving, write a static copy of the page, with recorded episodes, to this new folder, for any web
    /// server.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["web", "token"])]
    pub(crate) export: Option<PathBuf>,
    /// Record this blueprint in the copy: an id, a file, or a folder of files; may be repeated [default: one of each
    /// group].
    #[arg(long, value_name = "FILE|ID", requires = "export")]
    pub(crate) blueprint: Vec<OsString>,
}

/// Arguments of `report`.
#[derive(Clone, Debug, Args)]
pub struct ReportArgs {
    /// Folder of a run, in which the evaluator keeps eval.db, or of a sweep.
    #[arg(value_name = "RUN")]
    pub(crate) run: PathBuf,
    /// Folder for the tables; created if it does not exist [default: RUN/report].
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// Actions of the tables by step, greedy or sampled [default: greedy where there are evaluations of them].
    #[arg(long, value_name = "ACTING")]
    pub(crate) acting: Option<ActionMode>,
    /// Also write RUN and other runs into one table, on the blueprints that all of them evaluated.
    #[arg(long, value_name = "RUN2", num_args = 1..)]
    pub(crate) beside: Vec<PathBuf>,
    /// Print the table of groups and the names of the written files as JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

/// Arguments of `render`.
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// Recorded trajectories, for example from `record`. For the folder of a run, all recordings of its evaluator.
    #[arg(value_name = "FILE_OR_RUN", required = true)]
    pub(crate) files: Vec<PathBuf>,
    /// Folder for the output; created if it does not exist.
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// Output format.
    #[arg(long, value_enum, default_value_t = VideoFormat::Mp4)]
    pub(crate) format: VideoFormat,
    /// Frames per second, at most 50 for a GIF [default: 30 for an MP4; 10 for a GIF or with --attention].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_FPS)))]
    pub(crate) fps: Option<u32>,
    /// Width in pixels; odd widths are made even [default: 960 for an MP4, 640 for a GIF, 1200 for a strip, and 1280
    /// with --attention].
    #[arg(long, value_name = "N", value_parser = RangedU64ValueParser::<usize>::new().range(MIN_WIDTH as u64..=MAX_WIDTH as u64))]
    pub(crate) width: Option<usize>,
    /// Only episodes with this goal: an id, a file, or a folder of files; may be repeated.
    #[arg(long, value_name = "FILE|ID")]
    pub(crate) blueprint: Vec<OsString>,
    /// Show what every attention head of a network attends to during the episode, whichever policy acted: the network
    /// of a run's best policy, of one checkpoint, or of an exported file.
    #[arg(long, value_name = "DIR")]
    pub(crate) attention: Option<PathBuf>,
    /// Print what each head attends to, averaged over all scenes of all files, and write it to attention.csv; no videos.
    #[arg(long, requires = "attention", conflicts_with_all = ["format", "fps", "width"])]
    pub(crate) table: bool,
}

/// Output format of `render`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum VideoFormat {
    /// A video that every browser plays.
    Mp4,
    /// An animated picture, for places that cannot play videos.
    Gif,
    /// One picture: the goal and seven scenes or, with --attention, one row per head.
    PngStrip,
}

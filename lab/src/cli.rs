//! The command-line interface.

use std::path::PathBuf;

use blueprints::N_BLOCKS;
use clap::{Args, Parser, Subcommand, ValueEnum};
use deploy::cli::ConfigArgs;
use deploy::telemetry::LogFormat;

use crate::generator::Style;

/// Measures, and generates blueprints, with code that is not part of the shipped program.
#[derive(Debug, Parser)]
#[command(name = "lab", max_term_width = 100, arg_required_else_help = true)]
pub(crate) struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub(crate) command: Command,
    /// Format of log lines; RUST_LOG selects what is logged.
    #[arg(long, global = true, value_enum, default_value_t, env = "LODESTONE_LOG_FORMAT")]
    pub(crate) log_format: LogFormat,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Send recorded segments from simulated actors through a router to a learner's ingest, and pull weights.
    ///
    /// The router, the ingest, and the actors are separate processes on this machine. The ingest is a learner's,
    /// without the training. At the end, the counts of both ends are compared; the exit code is 1 if an acknowledged
    /// segment was lost.
    Actors(Box<ActorsArgs>),
    /// Generate blueprints that are not in the catalog, one file each.
    Generate(GenerateArgs),
    /// A router process of `actors`, configured on stdin.
    #[command(hide = true)]
    Router,
    /// The ingest process of `actors`, configured on stdin.
    #[command(hide = true)]
    Ingest,
    /// A process with some of the actors of `actors`, configured on stdin.
    #[command(hide = true)]
    Load,
}

/// Arguments of `generate`.
#[derive(Debug, Args)]
pub(crate) struct GenerateArgs {
    /// Blocks per blueprint.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(2..=N_BLOCKS as i64))]
    pub(crate) size: u8,
    /// How many to generate: the most varied of about four times as many candidates.
    #[arg(long, value_name = "K", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=500))]
    pub(crate) count: u16,
    /// Random seed: different seeds generate different structures, equal seeds the same ones.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub(crate) seed: u64,
    /// Style of the structures.
    #[arg(long, value_enum, value_name = "STYLE", default_value_t = Style::Any)]
    pub(crate) style: Style,
    /// Folder for the files; created if it does not exist.
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
}

/// Arguments of `actors`.
#[derive(Debug, Args)]
pub(crate) struct ActorsArgs {
    /// The configuration that segments are recorded with; it also sets the sizes of the mailbox, the update, and the
    /// network.
    #[command(flatten)]
    pub(crate) config: ConfigArgs,
    /// Actors, each with its own bus session.
    #[arg(long, value_name = "N", default_value_t = 3000, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub(crate) actors: u32,
    /// Steps per second of each actor, by default as in the paper; 0 sends as fast as acknowledgments arrive.
    #[arg(long, value_name = "R", default_value_t = 1.9, value_parser = steps_rate)]
    pub(crate) rate: f64,
    /// How long to send, in seconds.
    #[arg(long = "for", value_name = "S", default_value_t = 600, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    pub(crate) seconds: u64,
    /// Size of the weights' parameters in bytes [default: that of the network].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(4..=67_108_864))]
    pub(crate) weights_bytes: Option<u64>,
    /// Seconds between publications of weights; 0 publishes once, at the start.
    #[arg(long, value_name = "S", default_value_t = 60.0, value_parser = rate)]
    pub(crate) weights_every: f64,
    /// Processes that the actors are spread over [default: one per 1000 actors, and at least one per leaf].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub(crate) processes: Option<u32>,
    /// Leaf routers that the actors are spread over; 0 connects the actors to the root router.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=100))]
    pub(crate) leaves: u32,
    /// Transport between the processes.
    #[arg(long, value_enum, default_value_t = Transport::Tcp)]
    pub(crate) transport: Transport,
    /// Use the router at this endpoint instead of starting one; its CPU time and memory are then not measured.
    #[arg(long, value_name = "ENDPOINT", conflicts_with_all = ["leaves", "transport"])]
    pub(crate) connect: Option<String>,
    /// Print the report as JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

/// Transport between processes on one machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Transport {
    /// TCP on 127.0.0.1.
    Tcp,
    /// Unix sockets.
    Unix,
}

/// Rejects nonzero rates below one step in 1000 s: they are typos, and the interval may be longer than a clock can
/// express.
fn steps_rate(text: &str) -> Result<f64, String> {
    let rate = rate(text)?;
    if rate == 0.0 || rate >= 1e-3 { Ok(rate) } else { Err("expected 0, or 0.001 to 1000000".to_owned()) }
}

fn rate(text: &str) -> Result<f64, String> {
    let rate: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    if (0.0..=1e6).contains(&rate) { Ok(rate) } else { Err("expected 0 to 1000000".to_owned()) }
}

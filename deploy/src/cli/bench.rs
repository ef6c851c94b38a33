//! `bench …`.

use clap::{Args, Subcommand, ValueEnum};

use super::ConfigArgs;

/// What is to be measured.
#[derive(Debug, Subcommand)]
pub enum BenchCommand {
    /// Simulated actors send recorded segments over a router to a learner's ingest and pull weights.
    ///
    /// Router, ingest and actors are processes of their own on this machine. The ingest is a learner's without its arithmetic.
    /// At the end both ends' counts are compared; the exit code is 1 if an acknowledged segment was lost.
    Actors(Box<BenchActorsArgs>),
    /// A router of `bench actors`, told on stdin.
    #[command(hide = true)]
    Router,
    /// The ingest of `bench actors`, told on stdin.
    #[command(hide = true)]
    Ingest,
    /// Some of the actors of `bench actors`, told on stdin.
    #[command(hide = true)]
    Load,
}

/// Arguments of `bench actors`.
#[derive(Debug, Args)]
pub struct BenchActorsArgs {
    /// Whose segments are recorded, and the sizes of mailbox, update and network.
    #[command(flatten)]
    pub config: ConfigArgs,
    /// Actors, each with a session of its own.
    #[arg(long, value_name = "N", default_value_t = 3000, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub actors: u32,
    /// Steps per second of each actor, as in the paper by default; 0 sends as fast as answers come.
    #[arg(long, value_name = "R", default_value_t = 1.9, value_parser = steps_rate)]
    pub rate: f64,
    /// Seconds to send.
    #[arg(long = "for", value_name = "S", default_value_t = 600, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    pub seconds: u64,
    /// Bytes of the weights' parameters [default: those of the network].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(4..=67_108_864))]
    pub weights_bytes: Option<u64>,
    /// Seconds between two publications of weights; 0 publishes once, at the start.
    #[arg(long, value_name = "S", default_value_t = 60.0, value_parser = rate)]
    pub weights_every: f64,
    /// Processes that the actors share [default: one per 1000 actors, and at least one per leaf].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub processes: Option<u32>,
    /// Routers below the first, which the actors share; 0 connects actors to the first.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=100))]
    pub leaves: u32,
    /// How the processes are connected.
    #[arg(long, value_enum, default_value_t = Transport::Tcp)]
    pub transport: Transport,
    /// Use the router that listens here instead of one's own, whose processor time and memory then stay unknown.
    #[arg(long, value_name = "ENDPOINT", conflicts_with_all = ["leaves", "transport"])]
    pub connect: Option<String>,
    /// Print the result as JSON.
    #[arg(long)]
    pub json: bool,
}

/// How processes of one machine are connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Transport {
    /// TCP on 127.0.0.1.
    Tcp,
    /// Unix sockets.
    Unix,
}

/// Slower than once in a quarter of an hour is a mistake, and times that no clock can express.
fn steps_rate(text: &str) -> Result<f64, String> {
    let rate = rate(text)?;
    if rate == 0.0 || rate >= 1e-3 { Ok(rate) } else { Err("expected 0, or 0.001 to 1000000".to_owned()) }
}

fn rate(text: &str) -> Result<f64, String> {
    let rate: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    if (0.0..=1e6).contains(&rate) { Ok(rate) } else { Err("expected 0 to 1000000".to_owned()) }
}

//! Arguments of `watch`.

use clap::Args;

use super::KeysArgs;
use super::values::endpoint;

/// Arguments of `watch`.
#[derive(Debug, Args)]
pub struct WatchArgs {
    /// Endpoint of the run's router, for example tcp/127.0.0.1:7447, quic/HOST:7447 or unixsock-stream//tmp/bus.sock; may be
    /// repeated.
    #[arg(long, value_name = "ENDPOINT", required = true, env = "LODESTONE_CONNECT", value_delimiter = ',', value_parser = endpoint)]
    pub connect: Vec<String>,
    /// Name of the run; processes that were not told one have their preset's.
    #[arg(long, value_name = "NAME", default_value = "quickstart", env = "LODESTONE_RUN")]
    pub run: String,
    /// Keys, of which those of the role viewer are used.
    #[command(flatten)]
    pub keys: KeysArgs,
    /// Print what is known as text and end, as soon as the learner or the evaluator has said something.
    #[arg(long)]
    pub once: bool,
    /// Print it as JSON; without --once a line whenever something is new, at most one a second.
    #[arg(long)]
    pub json: bool,
    /// Longest time to wait for that, seconds.
    #[arg(long, value_name = "S", default_value_t = 30, requires = "once", value_parser = clap::value_parser!(u64).range(1..=86_400))]
    pub timeout: u64,
}

//! Arguments of `watch`.

use std::path::PathBuf;

use clap::Args;

use super::KeysArgs;
use super::values::endpoint;

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
    /// Longest time that --once waits, in seconds.
    #[arg(long, value_name = "S", default_value_t = 30, requires = "once", value_parser = clap::value_parser!(u64).range(1..=86_400))]
    pub(crate) timeout: u64,
}

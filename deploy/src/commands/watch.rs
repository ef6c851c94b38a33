//! `watch`: joins a run to look at it.

use std::time::Duration;

use proto::bus::{BusConfig, BusMode, SecurityConfig};
use tokio_util::sync::CancellationToken;

use crate::cli::WatchArgs;
use crate::exit::Failure;
use crate::live::Terminal;
use crate::watch;

/// Shows the run until it is ended, or once.
///
/// # Errors
/// When the run's name breaks the rule, stdout is no terminal where one is needed, or the bus fails.
pub(super) async fn run(args: &WatchArgs, terminal: &Terminal, shutdown: CancellationToken) -> Result<(), Failure> {
    let (run, connect) = (args.run.clone(), args.connect.clone());
    let security = SecurityConfig { keys: args.keys.folder("viewer") };
    let config = BusConfig { run, connect, security, mode: BusMode::Client, ..BusConfig::default() };
    config.validate().map_err(|error| Failure::Usage(format!("--run or --connect: {error}")))?;
    if args.once {
        watch::once(config, Duration::from_secs(args.timeout), terminal, shutdown).await
    } else {
        watch::live(config, terminal, shutdown).await
    }
}

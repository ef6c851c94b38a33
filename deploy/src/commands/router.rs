//! `router`: carries the messages of all runs whose processes connect to it.

use proto::bus::{Bus, BusConfig, BusMode};
use tokio_util::sync::CancellationToken;

use crate::cli::RouterArgs;
use crate::exit::Failure;

/// Routes until `shutdown`.
///
/// # Errors
/// When an endpoint cannot be listened on.
pub(super) async fn run(args: &RouterArgs, shutdown: CancellationToken) -> Result<(), Failure> {
    // The name of a run prefixes only what a process itself sends, so one router serves every run.
    let (listen, connect) = (args.listen.clone(), args.connect.clone());
    let config = BusConfig { mode: BusMode::Router, listen, connect, ..BusConfig::default() };
    let bus = Bus::open(&config).await?;
    tracing::info!(listen = ?config.listen, "routing");
    shutdown.cancelled().await;
    bus.close().await?;
    Ok(())
}

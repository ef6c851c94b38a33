//! `router`: routes the messages of all runs whose processes connect to it.

use bus::{BusConfig, BusMode, SecurityConfig};
use proto::Valid;
use tokio_util::sync::CancellationToken;

use super::common::join_bus;
use crate::cli::RouterArgs;
use crate::config::ConfigError;
use crate::exit::Failure;
use crate::health::Reporter;

/// Routes messages until `shutdown`.
pub(super) async fn run(args: &RouterArgs, shutdown: CancellationToken) -> Result<(), Failure> {
    // A run's name prefixes only the keys that its own processes use, so one router serves every run.
    let (listen, connect) = (args.listen.clone(), args.connect.clone());
    let security = SecurityConfig { keys: args.keys.folder("router") };
    let config = BusConfig { mode: BusMode::Router, listen, connect, security, ..BusConfig::default() };
    let config = Valid::new(config).map_err(ConfigError::from)?;
    let health = Reporter::start("router", args.health.health_file.as_deref())?;
    let Some(bus) = join_bus(&config, &shutdown).await? else { return Ok(()) };
    health.joined(&bus);
    // A router has no main loop that could hang.
    let _waiting = bus.pulse().waiting();
    tracing::info!(listen = ?config.listen, with_keys = config.security.keys.is_some(), "routing");
    shutdown.cancelled().await;
    bus.close().await;
    Ok(())
}

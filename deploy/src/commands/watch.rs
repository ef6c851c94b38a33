//! `watch`: joins a run to monitor it.

use proto::Valid;
use std::io::{self, Write};
use std::time::Duration;

use blueprints::outside::printable;
use bus::{BusConfig, BusMode, SecurityConfig};
use dashboard::terminal::{self as view, Format, WatchError};
use tokio_util::sync::CancellationToken;

use crate::cli::WatchArgs;
use crate::exit::Failure;
use crate::live::Terminal;

/// Delay before the notice that the run has not answered yet.
const NOTICE: Duration = Duration::from_secs(3);

/// Shows the run until `shutdown`, or once. A stream of JSON also ends when its reader closes the pipe.
///
/// # Errors
/// When the run's name or an endpoint is invalid, stdout is not a terminal where one is needed, or the bus fails.
pub(super) async fn run(args: &WatchArgs, terminal: &Terminal, shutdown: CancellationToken) -> Result<(), Failure> {
    let (run, connect) = (args.run.clone(), args.connect.clone());
    let security = SecurityConfig { keys: args.keys.folder("viewer") };
    let config = BusConfig { run, connect, security, mode: BusMode::Client, ..BusConfig::default() };
    let config = Valid::new(config).map_err(|error| Failure::Usage(format!("--run or --connect: {error}")))?;
    if args.once {
        let format = if args.json { Format::Json } else { Format::Text };
        let notice = async {
            tokio::time::sleep(NOTICE).await;
            let (run, endpoints, seconds) = (&args.run, args.connect.join(", "), args.timeout);
            terminal.on_stderr().print(&format!("waiting up to {seconds} s for the run `{run}` at {endpoints}"));
            std::future::pending::<()>().await;
        };
        let known = tokio::select! {
            known = view::once(config, format, Duration::from_secs(args.timeout), shutdown) => known?,
            () = notice => unreachable!("it has no end"),
        };
        terminal.print(&known);
    } else if args.json {
        let print = |known: &serde_json::Value| writeln!(io::stdout(), "{}", printable(&known.to_string()));
        view::stream(config, shutdown, print).await.map_err(|error| match error {
            WatchError::Terminal(error) => Failure::Output(error),
            error => error.into(),
        })?;
    } else {
        let _held = terminal.hold_log();
        view::live(config, shutdown).await?;
    }
    Ok(())
}

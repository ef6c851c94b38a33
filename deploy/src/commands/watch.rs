//! `watch`: joins a run to monitor it.

use proto::Valid;
use std::io::{self, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

use blueprints::outside::printable;
use bus::{BusConfig, BusMode, SecurityConfig};
use dashboard::terminal::{self as view, Format, WatchError};
use runlog::RunPaths;
use tokio_util::sync::CancellationToken;

use crate::cli::WatchArgs;
use crate::config::{Config, DEFAULT_PRESET, read};
use crate::exit::Failure;
use crate::live::Terminal;
use crate::run_dir::check_run;
use crate::shell;

/// Delay before the notice that the run has not answered yet.
const NOTICE: Duration = Duration::from_secs(3);

/// Shows the run until `shutdown`, or once. A stream of JSON also ends when its reader closes the pipe.
///
/// # Errors
/// When the run's name or an endpoint is invalid, stdout is not a terminal where one is needed, or the bus fails.
pub(super) async fn run(args: &WatchArgs, terminal: &Terminal, shutdown: CancellationToken) -> Result<(), Failure> {
    let config = Valid::new(joining(args)?).map_err(|error| Failure::Usage(format!("--run or --connect: {error}")))?;
    if args.once {
        let run = config.run.clone();
        let endpoints = config.connect.join(", ");
        let seconds = args.timeout;
        let format = if args.json { Format::Json } else { Format::Text };
        let notice = async {
            tokio::time::sleep(NOTICE).await;
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

/// How to join the run that the arguments name, or else the newest one that trains on this machine.
fn joining(args: &WatchArgs) -> Result<BusConfig, Failure> {
    if !args.connect.is_empty() {
        let run = args.run.clone().unwrap_or_else(|| DEFAULT_PRESET.to_owned());
        let security = SecurityConfig { keys: args.keys.folder("viewer") };
        let connect = args.connect.clone();
        return Ok(BusConfig { run, connect, security, mode: BusMode::Client, ..BusConfig::default() });
    }
    let folder = match &args.folder {
        Some(folder) => folder.clone(),
        None => newest(Path::new("runs"))?,
    };
    check_run(&folder)?;
    if !is_training(&folder) {
        let shown = folder.display();
        let path = shell::path(&folder);
        let program = shell::program();
        return Err(Failure::Usage(format!(
            "no training listens in {shown}; `{program} serve {path}` shows its files"
        )));
    }
    let file = RunPaths::new(&folder).config();
    let run = Config::parse(&read(&file)?, &file.display().to_string())?.bus.run;
    let connect = vec![BusConfig::socket_endpoint(&folder)];
    Ok(BusConfig { run, connect, mode: BusMode::Client, ..BusConfig::default() })
}

/// The folder in `runs` in which a training listens since the latest time.
fn newest(runs: &Path) -> Result<PathBuf, Failure> {
    let folders = std::fs::read_dir(runs).into_iter().flatten().flatten().map(|entry| entry.path());
    let since = |folder: &PathBuf| std::fs::metadata(BusConfig::socket(folder)).and_then(|file| file.modified()).ok();
    folders.filter(|folder| is_training(folder)).max_by_key(since).ok_or_else(|| {
        let program = shell::program();
        Failure::Usage(format!(
            "no training listens in runs/; name its folder (`{program} watch FOLDER`) or its router (--connect)"
        ))
    })
}

/// Whether a training of this machine lets others join by a socket in its folder.
fn is_training(folder: &Path) -> bool {
    UnixStream::connect(BusConfig::socket(folder)).is_ok()
}

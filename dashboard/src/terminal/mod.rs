//! The `watch` command: shows the current state of a run on screen or as text.
//!
//! Reading order: `view` (formats the state as lines) → `screen` (the terminal).

mod screen;
mod view;

use proto::Valid;
use std::convert::Infallible;
use std::io::{self, IsTerminal};
use std::time::{Duration, Instant};

use bus::{Bus, BusConfig, BusError};
use serde_json::Value;
use tokio::sync::watch;
use tokio::task::JoinError;
use tokio::time::{MissedTickBehavior, timeout};
use tokio_util::sync::CancellationToken;

use crate::follow::{News, follow};
use crate::run_view::{Link, RunView};
pub use view::seconds;

/// With `--once`, how long no message must arrive after the first summary before the state is printed.
const QUIET: Duration = Duration::from_millis(300);

/// With `--once`, the longest time to wait for further messages after the first summary.
const LONGEST_SETTLING: Duration = Duration::from_secs(3);

/// Shortest time between two lines of a stream.
const STREAM_PERIOD: Duration = Duration::from_secs(1);

/// How often the router is queried for other runs while this one is empty.
const SEEK_PERIOD: Duration = Duration::from_secs(2);

/// Output format of [`once`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// The lines of the live view.
    Text,
    /// One object, as in a [`stream`]: `run`, `is_connected`, `learner`, `evaluation`, `blueprints`, `actors` and
    /// `alive`, with the metrics as they are on the bus and `null` for metrics that have not arrived.
    Json,
}

/// Why a run cannot be shown in the terminal.
#[derive(Debug, thiserror::Error)]
pub enum WatchError {
    /// Stdout is not a terminal.
    #[error("watch needs a terminal on stdout; --once prints what is known as text, --json prints lines for programs")]
    NoTerminal,
    /// The router is connected, but the run's learner and evaluator are silent.
    #[error("{0}")]
    Silent(String),
    /// No router is reachable.
    #[error("{0}")]
    NoRouter(String),
    /// The bus cannot be opened, or the session fails.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The terminal cannot be set up, read from or drawn to.
    #[error(transparent)]
    Terminal(#[from] io::Error),
    /// The task that follows the bus panicked.
    #[error(transparent)]
    Panic(#[from] JoinError),
}

/// Shows the run on the screen until a key press or `shutdown` ends it.
///
/// # Errors
/// Returns an error if stdout is not a terminal, the bus cannot be opened, or the terminal fails.
pub async fn live(config: Valid<BusConfig>, shutdown: CancellationToken) -> Result<(), WatchError> {
    if !io::stdout().is_terminal() {
        return Err(WatchError::NoTerminal);
    }
    let named = config.clone();
    let start = Instant::now();
    following(config, start, shutdown, async |run, shutdown| Ok(screen::show(run, &named, start, &shutdown).await?))
        .await
}

/// Returns the known state once metrics from the learner or the evaluator have arrived; an empty string after
/// `shutdown`.
///
/// # Errors
/// Returns an error if no metrics arrive within `patience`, or the bus cannot be opened.
pub async fn once(
    config: Valid<BusConfig>,
    format: Format,
    patience: Duration,
    shutdown: CancellationToken,
) -> Result<String, WatchError> {
    let its_config = config.clone();
    let start = Instant::now();
    following(config, start, shutdown, async |mut run, shutdown| {
        let arrives = async {
            drop(timeout(patience, run.wait_for(|run| run.link == Link::Connected)).await?);
            timeout(patience, run.wait_for(RunView::has_summary)).await
        };
        let Some(arrived) = shutdown.run_until_cancelled(arrives).await else { return Ok(String::new()) };
        match arrived.map(|run| run.is_ok()) {
            Ok(true) => {}
            // The bus failed. `following` returns the error.
            Ok(false) => return Ok(String::new()),
            Err(_) => {
                let link = run.borrow().link;
                let error = shutdown.run_until_cancelled(silent(link, &its_config, patience)).await;
                return error.map_or_else(|| Ok(String::new()), Err);
            }
        }
        let settled = async { while let Ok(Ok(())) = timeout(QUIET, run.changed()).await {} };
        let _: Result<(), _> = timeout(LONGEST_SETTLING, settled).await;
        let run = run.borrow();
        Ok(match format {
            Format::Text => view::text(&run, &its_config, start.elapsed()),
            Format::Json => format!("{:#}", run.to_json(&its_config.run)),
        })
    })
    .await
}

/// Passes the known state to `print`, as in [`Format::Json`], whenever it changes but at most once a second, until
/// `shutdown` or until `print` reports a broken pipe.
///
/// # Errors
/// Returns an error if the bus cannot be opened, or `print` fails for another reason.
pub async fn stream(
    config: Valid<BusConfig>,
    shutdown: CancellationToken,
    mut print: impl FnMut(&Value) -> io::Result<()>,
) -> Result<(), WatchError> {
    let name = config.run.clone();
    following(config, Instant::now(), shutdown, async |mut run, shutdown| {
        let mut period = tokio::time::interval(STREAM_PERIOD);
        period.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut last = Value::Null;
        while shutdown.run_until_cancelled(period.tick()).await.is_some() {
            let known = run.borrow_and_update().to_json(&name);
            if known != last {
                match print(&known) {
                    Err(error) if error.kind() == io::ErrorKind::BrokenPipe => return Ok(()),
                    printed => printed?,
                }
                last = known;
            }
            // The bus failed, unless this is the end. `following` returns the error.
            let Some(Ok(())) = shutdown.run_until_cancelled(run.changed()).await else { return Ok(()) };
        }
        Ok(())
    })
    .await
}

/// Runs `show` alongside a task that keeps its view of the run up to date.
async fn following<T>(
    config: Valid<BusConfig>,
    start: Instant,
    shutdown: CancellationToken,
    show: impl AsyncFnOnce(watch::Receiver<RunView>, CancellationToken) -> Result<T, WatchError>,
) -> Result<T, WatchError> {
    let (writer, run) = watch::channel(RunView::default());
    let follower = tokio::spawn(keep(writer, config, start, shutdown.clone()));
    let shown = show(run, shutdown.clone()).await;
    shutdown.cancel();
    follower.await??;
    shown
}

/// Keeps `run` up to date until `shutdown`. Its times count from `start`.
async fn keep(
    run: watch::Sender<RunView>,
    config: Valid<BusConfig>,
    start: Instant,
    shutdown: CancellationToken,
) -> Result<(), BusError> {
    let Some(opened) = shutdown.run_until_cancelled(Bus::open(&config)).await else { return Ok(()) };
    let bus = opened?;
    let tell = |news, now| {
        run.send_if_modified(|run| match news {
            News::Metrics(sample) => {
                run.take(&sample, now);
                // A rejected sample still changes a counter.
                true
            }
            News::Session(session) => run.set_session(&session, now),
        });
    };
    let ended = tokio::select! {
        ended = follow(&bus, start, &shutdown, tell) => ended,
        never = seek_others(&run, &config) => match never {},
    };
    bus.close().await;
    ended
}

/// While the run is empty, looks up the other runs on the router, because the run name may be wrong.
async fn seek_others(run: &watch::Sender<RunView>, config: &Valid<BusConfig>) -> Infallible {
    let mut period = tokio::time::interval(SEEK_PERIOD);
    loop {
        period.tick().await;
        let is_alone = run.borrow().link == Link::Connected && run.borrow().is_empty();
        if !is_alone {
            continue;
        }
        match bus::runs(config).await {
            Ok(others) => run.send_modify(|run| run.others = others),
            Err(error) => tracing::debug!(%error, "the router's runs cannot be listed"),
        }
    }
}

/// Returns the error for a run that sent no metrics within `patience`.
async fn silent(link: Link, config: &Valid<BusConfig>, patience: Duration) -> WatchError {
    let seconds = patience.as_secs();
    if link != Link::Connected {
        let endpoints = config.connect.join(", ");
        return WatchError::NoRouter(format!("no router answers at {endpoints} after {seconds} s"));
    }
    let others = bus::runs(config).await;
    let others = others.inspect_err(|error| tracing::debug!(%error, "the router's runs cannot be listed"));
    let others: Vec<String> = others.unwrap_or_default().into_iter().collect();
    let elsewhere = match &others[..] {
        [] => "--run NAME chooses another run".to_owned(),
        names => format!("this router has {}; --run NAME chooses one", names.join(", ")),
    };
    let run = &config.run;
    WatchError::Silent(format!("no learner and no evaluator of run `{run}` said anything in {seconds} s; {elsewhere}"))
}

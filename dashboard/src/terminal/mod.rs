//! `watch`: a run as it is now, on a screen or as one text.
//!
//! Reading order: [`board`] (what is known) → `follow` (from the bus) → [`view`] (as lines) → `screen` (the terminal).

pub mod board;
mod follow;
mod screen;
pub mod view;

use std::io::{self, IsTerminal};
use std::time::{Duration, Instant};

use bus::{BusConfig, BusError};
use tokio::sync::watch;
use tokio::task::JoinError;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

use self::board::{Board, Link};
use self::view::Source;

/// With `--once`, the board is printed when nothing has come for this time after the first summary.
const QUIET: Duration = Duration::from_millis(300);

/// With `--once`, the longest time that is given to what comes with the first summary.
const LONGEST_SETTLING: Duration = Duration::from_secs(3);

/// Why a run cannot be shown in the terminal.
#[derive(Debug, thiserror::Error)]
pub enum WatchError {
    /// There is no screen to draw on.
    #[error("watch needs a terminal on stdout; --once prints what is known as text")]
    NoTerminal,
    /// The bus is there, but nobody on it says anything.
    #[error("no learner and no evaluator of run `{run}` said anything in {seconds} s; --run names another")]
    Silent {
        /// Name of the run.
        run: String,
        /// How long was waited.
        seconds: u64,
    },
    /// No router is there.
    #[error("no router answers at {endpoints} after {seconds} s")]
    NoRouter {
        /// Where one was looked for.
        endpoints: String,
        /// How long was waited.
        seconds: u64,
    },
    /// The bus cannot be opened, or the session fails.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The terminal cannot be taken, read or drawn on.
    #[error(transparent)]
    Terminal(#[from] io::Error),
    /// What follows the bus panicked.
    #[error(transparent)]
    Panic(#[from] JoinError),
}

/// Shows the run on the screen until a key or `shutdown` ends it.
///
/// # Errors
/// If stdout is no terminal, the bus cannot be opened, or the terminal fails.
pub async fn live(config: BusConfig, shutdown: CancellationToken) -> Result<(), WatchError> {
    if !io::stdout().is_terminal() {
        return Err(WatchError::NoTerminal);
    }
    let (source, start) = (source(&config), Instant::now());
    following(
        config,
        start,
        shutdown,
        async |board, shutdown| Ok(screen::show(board, &source, start, &shutdown).await?),
    )
    .await
}

/// What is known as soon as the learner or the evaluator has said something, as text; nothing after `shutdown`.
///
/// # Errors
/// If that takes longer than `patience`, or the bus cannot be opened.
pub async fn once(config: BusConfig, patience: Duration, shutdown: CancellationToken) -> Result<String, WatchError> {
    let (source, start) = (source(&config), Instant::now());
    following(config, start, shutdown, async |mut board, shutdown| {
        let arrived = tokio::select! {
            () = shutdown.cancelled() => return Ok(String::new()),
            arrived = timeout(patience, board.wait_for(Board::has_summary)) => arrived.map(|board| board.is_ok()),
        };
        match arrived {
            Ok(true) => {}
            // The bus has failed; why is told by what follows it.
            Ok(false) => return Ok(String::new()),
            Err(_) => return Err(silent(&board.borrow(), &source, patience)),
        }
        let settled = async { while let Ok(Ok(())) = timeout(QUIET, board.changed()).await {} };
        let _: Result<(), _> = timeout(LONGEST_SETTLING, settled).await;
        Ok(view::text(&board.borrow(), &source, start.elapsed()))
    })
    .await
}

/// Runs `show` beside a task that keeps its board up to date.
async fn following<T>(
    config: BusConfig,
    start: Instant,
    shutdown: CancellationToken,
    show: impl AsyncFnOnce(watch::Receiver<Board>, CancellationToken) -> Result<T, WatchError>,
) -> Result<T, WatchError> {
    let (writer, board) = watch::channel(Board::default());
    let follower = tokio::spawn(follow::follow(config, writer, start, shutdown.clone()));
    let shown = show(board, shutdown.clone()).await;
    shutdown.cancel();
    follower.await??;
    shown
}

/// Why there is nothing to print.
fn silent(board: &Board, source: &Source, patience: Duration) -> WatchError {
    let (run, seconds) = (source.run.clone(), patience.as_secs());
    match board.link().0 {
        Link::Connected => WatchError::Silent { run, seconds },
        Link::Joining | Link::Lost => WatchError::NoRouter { endpoints: source.endpoints.join(", "), seconds },
    }
}

fn source(config: &BusConfig) -> Source {
    Source { run: config.run.clone(), endpoints: config.connect.clone() }
}

#[cfg(test)]
mod samples;

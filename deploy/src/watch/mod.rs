//! `watch`: a run as it is now, on a screen or as one text.
//!
//! Reading order: [`board`] (what is known) → `follow` (from the bus) → [`view`] (as lines) → `screen` (the terminal).

pub mod board;
mod follow;
mod screen;
pub mod view;

use std::io::{self, IsTerminal};
use std::time::{Duration, Instant};

use anyhow::anyhow;
use proto::bus::BusConfig;
use tokio::sync::watch;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

use self::board::{Board, Link};
use self::view::Source;
use crate::exit::Failure;
use crate::live::Terminal;

/// With `--once`, the board is printed when nothing has come for this time after the first summary.
const QUIET: Duration = Duration::from_millis(300);

/// With `--once`, the longest time that is given to what comes with the first summary.
const LONGEST_SETTLING: Duration = Duration::from_secs(3);

/// Shows the run on the screen until a key or `shutdown` ends it.
///
/// # Errors
/// If stdout is no terminal, the bus cannot be opened, or the terminal fails.
pub async fn live(config: BusConfig, terminal: &Terminal, shutdown: CancellationToken) -> Result<(), Failure> {
    if !io::stdout().is_terminal() {
        return Err(Failure::Usage("watch needs a terminal on stdout; --once prints what is known as text".to_owned()));
    }
    let (source, start) = (source(&config), Instant::now());
    let held = terminal.hold_log();
    let shown = following(config, start, shutdown, async |board, shutdown| {
        screen::show(board, &source, start, &shutdown).await.map_err(|error| Failure::Service(error.into()))
    });
    let shown = shown.await;
    drop(held);
    shown
}

/// Prints what is known as soon as the learner or the evaluator has said something.
///
/// # Errors
/// If that takes longer than `patience`, or the bus cannot be opened.
pub async fn once(
    config: BusConfig,
    patience: Duration,
    terminal: &Terminal,
    shutdown: CancellationToken,
) -> Result<(), Failure> {
    let (source, start) = (source(&config), Instant::now());
    following(config, start, shutdown, async |mut board, shutdown| {
        let arrived = tokio::select! {
            () = shutdown.cancelled() => return Ok(()),
            arrived = timeout(patience, board.wait_for(Board::has_summary)) => arrived.map(|board| board.is_ok()),
        };
        match arrived {
            Ok(true) => {}
            // The bus has failed; why is told by what follows it.
            Ok(false) => return Ok(()),
            Err(_) => return Err(silent(&board.borrow(), &source, patience)),
        }
        let settled = async { while let Ok(Ok(())) = timeout(QUIET, board.changed()).await {} };
        let _: Result<(), _> = timeout(LONGEST_SETTLING, settled).await;
        terminal.print(&view::text(&board.borrow(), &source, start.elapsed()));
        Ok(())
    })
    .await
}

/// Runs `show` beside a task that keeps its board up to date.
async fn following(
    config: BusConfig,
    start: Instant,
    shutdown: CancellationToken,
    show: impl AsyncFnOnce(watch::Receiver<Board>, CancellationToken) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let (writer, board) = watch::channel(Board::default());
    let follower = tokio::spawn(follow::follow(config, writer, start, shutdown.clone()));
    let shown = show(board, shutdown.clone()).await;
    shutdown.cancel();
    let followed = follower.await.map_err(|panic| Failure::Service(panic.into()))?;
    followed?;
    shown
}

/// Why there is nothing to print.
fn silent(board: &Board, source: &Source, patience: Duration) -> Failure {
    let (seconds, endpoints) = (patience.as_secs(), source.endpoints.join(", "));
    match board.link().0 {
        Link::Connected => Failure::NothingToShow(format!(
            "no learner and no evaluator of run `{}` said anything in {seconds} s; --run names another",
            source.run
        )),
        Link::Joining | Link::Lost => Failure::Bus(anyhow!("no router answers at {endpoints} after {seconds} s")),
    }
}

fn source(config: &BusConfig) -> Source {
    Source { run: config.run.clone(), endpoints: config.connect.clone() }
}

#[cfg(test)]
mod samples;

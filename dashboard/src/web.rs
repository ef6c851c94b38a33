//! One web page about a running training: success over training, who is there, how learning goes.
//!
//! Reading order: `about` (which run) → `board` (what is known) → `events` (browsers that listen) → `replay`, `attention` and
//! `films` → `stage` and `gallery` (episodes on demand) → `drawing` (goals of one's own) → `prometheus` → `routes` (what can be
//! asked, and by whom) → `server` (connections) → `export` (a copy in files). The page never holds up an evaluator: whoever writes to the board takes a
//! lock for a moment, and what a browser does not take in time is dropped and counted.

mod about;
mod attention;
mod board;
mod drawing;
mod events;
mod export;
mod films;
mod gallery;
mod prometheus;
mod query;
mod replay;
mod routes;
mod server;
mod stage;

use std::borrow::Cow;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use blueprints::BlueprintId;
use bus::Bus;
use policy::PolicyConfig;
use proto::Weights;
use proto::metrics::LearnerMetrics;
use tokio::net::TcpListener;
use tokio::sync::{mpsc, watch};
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use crate::config::WebConfig;
use crate::follow::follow;
pub use about::{About, Kind};
use attention::Onlooker;
use board::Board;
use films::Films;
use replay::Replays;
use routes::Shown;
use runlog::{Pass, RunPaths};
pub use stage::{Builder, Order, Stage, StageError};

/// Longest silence that a browser sees.
const BEAT: Duration = Duration::from_secs(15);

/// Why the page cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum WebError {
    /// The address is taken, or not one of this machine.
    #[error(
        "the page cannot be served at {address}: {source}; choose another address with --web, or port 0 for a free one"
    )]
    Bind {
        /// The address of the configuration.
        address: SocketAddr,
        /// What the system says.
        source: std::io::Error,
    },
}

/// A page that has its address and waits to be opened.
#[derive(Debug)]
pub struct Page {
    listener: TcpListener,
    address: SocketAddr,
    config: WebConfig,
}

/// What a page shows besides what the bus tells.
#[derive(Debug)]
pub struct Source {
    /// Every evaluation, those of the history first. The page ends with it.
    pub passes: mpsc::UnboundedReceiver<Pass>,
    /// The newest weights, whose attention is shown, and the policy that they are for.
    pub weights: watch::Receiver<Option<Arc<Weights>>>,
    /// The policy.
    pub policy: PolicyConfig,
    /// The run whose video clips are shown; none shows none.
    pub run: Option<RunPaths>,
    /// The run in a few words.
    pub about: About,
    /// Where episodes are played on demand, if they are.
    pub stage: Option<Stage>,
}

/// A run that has ended, as its files tell it.
#[derive(Debug)]
pub struct FinishedRun {
    /// The run in a few words.
    pub about: About,
    /// Its evaluations in order.
    pub passes: Vec<Pass>,
    /// What its learner said of its updates, in order.
    pub learner: Vec<LearnerMetrics>,
    /// Its folder, for its video clips.
    pub run: RunPaths,
    /// The policy, and its newest weights if they can be read.
    pub policy: PolicyConfig,
    /// As above.
    pub weights: Option<Arc<Weights>>,
    /// Where episodes are played on demand, if they are.
    pub stage: Option<Stage>,
}

impl Page {
    /// Takes the address; browsers that come before the evaluator runs wait.
    ///
    /// # Errors
    /// When the address is taken or not one of this machine.
    pub async fn bind(config: &WebConfig) -> Result<Self, WebError> {
        let failed = |source| WebError::Bind { address: config.listen, source };
        let listener = TcpListener::bind(config.listen).await.map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        Ok(Self { listener, address, config: config.clone() })
    }

    /// The address with the port that the system has chosen for port 0.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Serves until no more evaluations can come; then all connections are closed.
    ///
    /// # Errors
    /// When the session fails, or a task of the page panicked.
    pub async fn serve(self, bus: &Bus, mut source: Source) -> anyhow::Result<()> {
        let board = Arc::new(Board::default());
        let shutdown = CancellationToken::new();
        let _ended_with_this = shutdown.clone().drop_guard();
        let replays = Arc::new(Replays::new(Onlooker::new(source.policy, source.weights)));
        let films = Films::new(source.run);
        let shown =
            Shown { about: source.about, board: board.clone(), replays: replays.clone(), films, stage: source.stage };
        let mut tasks = JoinSet::new();
        let first = shown.about.catalog.find(&shown.about.first()).map(Cow::into_owned);
        if let (Kind::Play, Some(stage), Some(first)) = (shown.about.kind, shown.stage.clone(), first) {
            let (replays, ended) = (replays.clone(), shutdown.clone());
            tasks.spawn(async move {
                tokio::select! {
                    () = ended.cancelled() => {}
                    () = stage.open_with(first, replays) => {}
                }
            });
        }
        let routes = routes::routes(shown, Vec::new(), self.config);
        tasks.spawn(replays.run(bus.clone(), shutdown.clone()));
        tasks.spawn(server::serve(self.listener, routes, board.clone(), shutdown.clone()));
        let (its_board, its_bus, its_shutdown) = (board.clone(), bus.clone(), shutdown.clone());
        let follower = tokio::spawn(async move {
            follow(&its_bus, Instant::now(), &its_shutdown, |news, now| its_board.told(news, now)).await
        });
        let mut beat = tokio::time::interval(BEAT);
        loop {
            tokio::select! {
                pass = source.passes.recv() => match pass {
                    Some(pass) => board.judged(&pass),
                    None => break,
                },
                _ = beat.tick() => board.beat(),
            }
        }
        shutdown.cancel();
        while let Some(task) = tasks.join_next().await {
            task.context("a task of the page panicked")?;
        }
        follower.await.context("what follows the bus panicked")??;
        Ok(())
    }

    /// Serves runs that have ended, the first at the root and the others beside it, until `shutdown`.
    ///
    /// # Errors
    /// When a task of the page panicked.
    pub async fn show(
        self,
        first: FinishedRun,
        others: Vec<FinishedRun>,
        shutdown: CancellationToken,
    ) -> anyhow::Result<()> {
        let first = first.into_shown();
        let others: Vec<Shown> = others.into_iter().map(FinishedRun::into_shown).collect();
        let boards: Vec<_> = std::iter::once(&first).chain(&others).map(|run| run.board.clone()).collect();
        let counting = first.board.clone();
        let routes = routes::routes(first, others, self.config);
        let server = tokio::spawn(server::serve(self.listener, routes, counting, shutdown.clone()));
        let mut beat = tokio::time::interval(BEAT);
        loop {
            tokio::select! {
                () = shutdown.cancelled() => break,
                _ = beat.tick() => boards.iter().for_each(|board| board.beat()),
            }
        }
        server.await.context("a task of the page panicked")
    }
}

/// Writes the page of runs that have ended into `folder`, which must not be there yet, for any web server to serve: with
/// an episode of each of `goals` by policy and expert where the run has weights. Returns the number of files.
///
/// # Errors
/// When the folder cannot be made or written.
pub async fn export(
    first: FinishedRun,
    others: Vec<FinishedRun>,
    goals: &[BlueprintId],
    folder: &Path,
) -> anyhow::Result<usize> {
    export::export(first.into_shown(), others.into_iter().map(FinishedRun::into_shown).collect(), goals, folder).await
}

impl FinishedRun {
    fn into_shown(self) -> Shown {
        let board = Arc::new(Board::default());
        self.passes.iter().for_each(|pass| board.judged(pass));
        self.learner.iter().for_each(|learner| board.learned(learner));
        let (_, weights) = watch::channel(self.weights);
        let replays = Arc::new(Replays::new(Onlooker::new(self.policy, weights)));
        Shown { about: self.about, board, replays, films: Films::new(Some(self.run)), stage: self.stage }
    }
}

#[cfg(test)]
mod tests;

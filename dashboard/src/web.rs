//! A web page about a running training: success over time, live processes, and learning metrics.
//!
//! Reading order: `about` (which run) → `board` (the known state) → `events` (connected browsers) → `replay`,
//! `attention` and `videos` → `stage` and `gallery` (episodes on demand) → `drawing` (user-drawn goals) → `prometheus` →
//! `assets` (the page's files) → `routes` (endpoints and access control) → `server` (connections) → `export` (a static
//! copy). The page never slows down the evaluator: writers to the board hold a lock only briefly, and events that a
//! browser does not read in time are dropped and counted.

mod about;
mod assets;
mod attention;
mod board;
mod drawing;
mod events;
mod export;
mod gallery;
mod prometheus;
mod query;
mod replay;
mod routes;
mod server;
mod stage;
mod videos;

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use bus::Bus;
use policy::PolicyConfig;
use proto::metrics::LearnerMetrics;
use proto::{Valid, Weights};
use serde_json::Value;
use tokio::net::TcpListener;
use tokio::sync::{mpsc, watch};
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use crate::config::WebConfig;
use crate::follow::follow;
pub use about::{About, Farewell, Kind};
use attention::Observer;
use board::Board;
use events::Places;
pub use export::export;
use replay::Replays;
use routes::Shown;
use runlog::{Evaluation, RunPaths};
pub use stage::{Builder, Order, Stage, StageError};
use videos::Videos;

/// Longest time between two events sent to a browser.
const BEAT: Duration = Duration::from_secs(15);

/// The page's address is in use or does not belong to this machine.
#[derive(Debug, thiserror::Error)]
#[error("the page cannot be served at {0}: {1}; choose another address with --web, or port 0 for a free one")]
pub struct WebError(SocketAddr, io::Error);

/// A page that is bound to its address but not yet served.
#[derive(Debug)]
pub struct Page {
    listener: TcpListener,
    address: SocketAddr,
    config: Valid<WebConfig>,
}

/// Data sources of a page, in addition to the bus.
#[derive(Debug)]
pub struct Source {
    /// All evaluations, starting with those of the history. The page stops when the channel closes.
    pub evaluations: mpsc::UnboundedReceiver<Evaluation>,
    /// The newest weights. The page shows their attention.
    pub weights: watch::Receiver<Option<Arc<Weights>>>,
    /// Configuration of the policy that the weights belong to.
    pub policy: Valid<PolicyConfig>,
    /// The run whose videos are shown; `None` for no videos.
    pub run: Option<RunPaths>,
    /// Summary of the run.
    pub about: About,
    /// Plays episodes on demand; `None` if the page offers none.
    pub stage: Option<Stage>,
}

/// What a page of finished runs shows.
#[derive(Debug)]
pub struct Finished {
    /// The run that is shown first.
    pub first: FinishedRun,
    /// The runs that can be chosen.
    pub others: Vec<FinishedRun>,
    /// The table and curves of the sweep that the runs belong to, as JSON.
    pub sweep: Option<Value>,
}

/// A finished run, read from its files.
#[derive(Debug)]
pub struct FinishedRun {
    /// Summary of the run.
    pub about: About,
    /// Its evaluations in order.
    pub evaluations: Vec<Evaluation>,
    /// The learner's metrics of its updates, in order.
    pub learner: Vec<LearnerMetrics>,
    /// Its directory, for its videos.
    pub run: RunPaths,
    /// Configuration of the policy.
    pub policy: Valid<PolicyConfig>,
    /// The newest weights, if they can be read.
    pub weights: Option<Arc<Weights>>,
    /// Plays episodes on demand; `None` if the page offers none.
    pub stage: Option<Stage>,
}

impl Page {
    /// Binds the address. Browsers that connect before [`Page::serve`] is called wait.
    ///
    /// # Errors
    /// Returns an error if the address is in use or does not belong to this machine.
    pub async fn bind(config: &Valid<WebConfig>) -> Result<Self, WebError> {
        let failed = |error| WebError(config.listen, error);
        let listener = TcpListener::bind(config.listen).await.map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        Ok(Self { listener, address, config: config.clone() })
    }

    /// Returns the bound address, with the port chosen by the system if port 0 was configured.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Serves until the evaluation channel closes, then tells browsers so and closes all connections.
    ///
    /// # Errors
    /// Returns an error if the session fails or a task of the page panics.
    pub async fn serve(self, bus: &Bus, mut source: Source) -> anyhow::Result<()> {
        let board = Arc::new(Board::default());
        let shutdown = CancellationToken::new();
        let _ended_with_this = shutdown.clone().drop_guard();
        let observer = Observer::new(source.policy, source.weights);
        let replays = Arc::new(Replays::new(observer, source.about.catalog.clone()));
        let videos = Videos(source.run);
        let shown =
            Shown { about: source.about, board: board.clone(), replays: replays.clone(), videos, stage: source.stage };
        let mut tasks = JoinSet::new();
        let first = shown.about.catalog.get(&shown.about.first()).cloned();
        if let (Kind::Play, Some(stage), Some(first)) = (shown.about.kind, shown.stage.clone(), first) {
            let (replays, ended) = (replays.clone(), shutdown.clone());
            tasks.spawn(async move {
                ended.run_until_cancelled(stage.open_with(first, replays)).await;
            });
        }
        let farewell = shown.about.farewell.clone();
        let places = Places::default();
        let routes = routes::routes(shown, Vec::new(), None, places.clone(), self.config);
        tasks.spawn(replays.run(bus.clone(), shutdown.clone()));
        tasks.spawn(server::serve(self.listener, routes, board.clone(), shutdown.clone()));
        let (its_board, its_bus, its_shutdown) = (board.clone(), bus.clone(), shutdown.clone());
        let follower = tokio::spawn(async move {
            follow(&its_bus, Instant::now(), &its_shutdown, |news, now| its_board.receive(news, now)).await
        });
        let mut beat = tokio::time::interval(BEAT);
        loop {
            tokio::select! {
                evaluation = source.evaluations.recv() => match evaluation {
                    Some(evaluation) => board.evaluated(&evaluation),
                    None => break,
                },
                _ = beat.tick() => board.beat(),
            }
        }
        board.ended(&farewell);
        places.left().await;
        shutdown.cancel();
        while let Some(task) = tasks.join_next().await {
            task.context("a task of the page panicked")?;
        }
        follower.await.context("what follows the bus panicked")??;
        Ok(())
    }

    /// Serves finished runs until `shutdown`: the first at the root, the others under `/runs/`.
    ///
    /// # Errors
    /// Returns an error if a task of the page panics.
    pub async fn show(self, finished: Finished, shutdown: CancellationToken) -> anyhow::Result<()> {
        let (first, others, sweep) = finished.into_shown();
        let boards: Vec<_> = std::iter::once(&first).chain(&others).map(|run| run.board.clone()).collect();
        let counting = first.board.clone();
        let farewell = first.about.farewell.clone();
        let places = Places::default();
        let routes = routes::routes(first, others, sweep, places.clone(), self.config);
        let closing = CancellationToken::new();
        let _closed_with_this = closing.clone().drop_guard();
        let server = tokio::spawn(server::serve(self.listener, routes, counting, closing.clone()));
        let mut beat = tokio::time::interval(BEAT);
        while shutdown.run_until_cancelled(beat.tick()).await.is_some() {
            boards.iter().for_each(|board| board.beat());
        }
        boards.iter().for_each(|board| board.ended(&farewell));
        places.left().await;
        closing.cancel();
        server.await.context("a task of the page panicked")
    }
}

impl Finished {
    fn into_shown(self) -> (Shown, Vec<Shown>, Option<Value>) {
        let others = self.others.into_iter().map(FinishedRun::into_shown).collect();
        (self.first.into_shown(), others, self.sweep)
    }
}

impl FinishedRun {
    fn into_shown(self) -> Shown {
        let board = Arc::new(Board::default());
        self.evaluations.iter().for_each(|evaluation| board.evaluated(evaluation));
        self.learner.iter().for_each(|learner| board.learned(learner));
        let (_, weights) = watch::channel(self.weights);
        let replays = Arc::new(Replays::new(Observer::new(self.policy, weights), self.about.catalog.clone()));
        Shown { about: self.about, board, replays, videos: Videos(Some(self.run)), stage: self.stage }
    }
}

#[cfg(test)]
mod tests;

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

/// A run that a page shows.
#[derive(Debug)]
pub struct ShownRun {
    /// Summary of the run.
    pub about: About,
    /// Its evaluations in order, as far as they are known.
    pub evaluations: Vec<Evaluation>,
    /// The learner's metrics of its updates, in order, as far as they are known.
    pub learner: Vec<LearnerMetrics>,
    /// Its directory, for its videos; `None` for no videos.
    pub run: Option<RunPaths>,
    /// Configuration of the policy that the weights belong to.
    pub policy: Valid<PolicyConfig>,
    /// The newest weights. The page shows their attention.
    pub weights: watch::Receiver<Option<Arc<Weights>>>,
    /// Plays episodes on demand; `None` if the page offers none.
    pub stage: Option<Stage>,
}

/// Runs that nothing adds to any longer.
#[derive(Debug)]
pub struct Finished {
    /// The run that is shown first.
    pub first: ShownRun,
    /// The runs that can be chosen.
    pub others: Vec<ShownRun>,
    /// The table and curves of the sweep that the runs belong to, as JSON.
    pub sweep: Option<Value>,
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

    /// Serves a run on the bus, and adds `evaluations` to those that are known, until their channel closes.
    ///
    /// # Errors
    /// Returns an error if the session fails or a task of the page panics.
    pub async fn serve(
        self,
        bus: &Bus,
        run: ShownRun,
        mut evaluations: mpsc::UnboundedReceiver<Evaluation>,
    ) -> anyhow::Result<()> {
        let shown = run.into_shown();
        let (board, replays) = (shown.board.clone(), shown.replays.clone());
        let ended = CancellationToken::new();
        let _ended_with_this = ended.clone().drop_guard();
        let recorder = tokio::spawn(replays.run(bus.clone(), ended.clone()));
        let (its_board, its_bus, its_end) = (board.clone(), bus.clone(), ended.clone());
        let follower = tokio::spawn(async move {
            follow(&its_bus, Instant::now(), &its_end, |news, now| its_board.receive(news, now)).await
        });
        let evaluated = async {
            while let Some(evaluation) = evaluations.recv().await {
                board.evaluated(&evaluation);
            }
            ended.cancel();
        };
        let (served, ()) = tokio::join!(self.serve_until(ended.clone(), shown, Vec::new(), None), evaluated);
        served?;
        recorder.await.context("a task of the page panicked")?;
        follower.await.context("what follows the bus panicked")??;
        Ok(())
    }

    /// Serves finished runs until `shutdown`: the first at the root, the others under `/runs/`.
    ///
    /// # Errors
    /// Returns an error if a task of the page panics.
    pub async fn show(self, finished: Finished, shutdown: CancellationToken) -> anyhow::Result<()> {
        let (first, others, sweep) = finished.into_shown();
        self.serve_until(shutdown, first, others, sweep).await
    }

    /// Serves until `shutdown`, then tells browsers so and closes all connections.
    async fn serve_until(
        self,
        shutdown: CancellationToken,
        first: Shown,
        others: Vec<Shown>,
        sweep: Option<Value>,
    ) -> anyhow::Result<()> {
        let boards: Vec<_> = std::iter::once(&first).chain(&others).map(|run| run.board.clone()).collect();
        let counting = first.board.clone();
        let farewell = first.about.farewell.clone();
        let closing = CancellationToken::new();
        let _closed_with_this = closing.clone().drop_guard();
        let goal = first.about.catalog.get(&first.about.first()).cloned();
        if let (Kind::Play, Some(stage), Some(goal)) = (first.about.kind, first.stage.clone(), goal) {
            let (replays, closed) = (first.replays.clone(), closing.clone());
            tokio::spawn(async move { closed.run_until_cancelled(stage.open_with(goal, replays)).await });
        }
        let places = Places::default();
        let routes = routes::routes(first, others, sweep, places.clone(), self.config);
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
        let others = self.others.into_iter().map(ShownRun::into_shown).collect();
        (self.first.into_shown(), others, self.sweep)
    }
}

impl ShownRun {
    fn into_shown(self) -> Shown {
        let board = Arc::new(Board::default());
        self.evaluations.iter().for_each(|evaluation| board.evaluated(evaluation));
        self.learner.iter().for_each(|learner| board.learned(learner));
        let replays = Arc::new(Replays::new(Observer::new(self.policy, self.weights), self.about.catalog.clone()));
        Shown { about: self.about, board, replays, videos: Videos(self.run), stage: self.stage }
    }
}

#[cfg(test)]
mod tests;

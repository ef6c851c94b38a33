//! One web page about a running training, served by the evaluator: success over training, who is there, how learning goes.
//!
//! Reading order: [`config`] → `board` (what is shown) → `events` (browsers that listen) → `replay`, `attention` and
//! `films` → `prometheus` → `routes` (what can be asked, and by whom) → `server` (connections). The page never holds up
//! the evaluator: whoever writes to the board takes a lock for a moment, and what a browser does not take in time is
//! dropped and counted.

mod attention;
mod board;
pub mod config;
mod events;
mod feed;
mod films;
mod prometheus;
mod replay;
mod routes;
mod server;

use std::net::SocketAddr;
use std::sync::Arc;

use policy::PolicyConfig;
use proto::Weights;
use proto::bus::Bus;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use crate::history::Pass;
use crate::run::RecordPaths;
use attention::Onlooker;
use board::Board;
use config::WebConfig;
use films::{Films, Folders};
use replay::Replays;

/// Why the page cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum WebError {
    /// The address is taken, or not one of this machine.
    #[error("the page cannot be served at {address}: {source}")]
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

/// A page that is being served.
pub(crate) struct OpenPage {
    board: Arc<Board>,
    shutdown: CancellationToken,
    tasks: Vec<tokio::task::JoinHandle<()>>,
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

    /// Serves until [`OpenPage::close`], beginning with the passes of `history`; films are those of `records`. Attention is
    /// that of the newest `weights` of a `policy`.
    pub(crate) async fn open(
        self,
        bus: &Bus,
        history: &[Pass],
        records: Option<&RecordPaths>,
        policy: PolicyConfig,
        weights: watch::Receiver<Option<Arc<Weights>>>,
    ) -> anyhow::Result<OpenPage> {
        let board = Arc::new(Board::default());
        history.iter().for_each(|pass| board.judged(pass));
        let feed = feed::Feed::open(bus).await?;
        let shutdown = CancellationToken::new();
        let replays = Arc::new(Replays::new(Onlooker::new(policy, weights)));
        let folders = records.map(|paths| Folders { videos: paths.videos.clone(), recordings: paths.replays.clone() });
        let routes = routes::routes(board.clone(), replays.clone(), Films::new(folders), self.config);
        let feeding = tokio::spawn(feed.run(board.clone(), shutdown.clone()));
        let recording = tokio::spawn(replays.run(bus.clone(), shutdown.clone()));
        let serving = tokio::spawn(server::serve(self.listener, routes, board.clone(), shutdown.clone()));
        Ok(OpenPage { board, shutdown, tasks: vec![feeding, recording, serving] })
    }
}

impl OpenPage {
    /// Shows a pass; returns at once.
    pub(crate) fn judged(&self, pass: &Pass) {
        self.board.judged(pass);
    }

    /// Ends all connections.
    pub(crate) async fn close(self) {
        self.shutdown.cancel();
        for task in self.tasks {
            if let Err(error) = task.await {
                tracing::warn!(%error, "a task of the page failed");
            }
        }
    }
}

#[cfg(test)]
mod tests;

//! From the bus to the board.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use bus::{AliveWatch, Bus, BusError, MetricsSubscriber};
use proto::Role;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use super::board::Board;

/// Longest silence that a browser sees.
const BEAT: Duration = Duration::from_secs(15);

/// What is followed on the bus.
pub(super) struct Feed {
    metrics: MetricsSubscriber,
    actors: AliveWatch,
    learners: AliveWatch,
    evaluators: AliveWatch,
}

impl Feed {
    /// Follows all metrics and who is alive.
    pub(super) async fn open(bus: &Bus) -> Result<Self, BusError> {
        Ok(Self {
            metrics: bus.metrics_subscriber("**").await?,
            actors: bus.alive(Role::Actor).await?,
            learners: bus.alive(Role::Learner).await?,
            evaluators: bus.alive(Role::Evaluator).await?,
        })
    }

    /// Writes it to the board until `shutdown` or until the bus is closed.
    pub(super) async fn run(mut self, board: Arc<Board>, shutdown: CancellationToken) {
        let mut actors = self.actors.watch();
        let mut learners = self.learners.watch();
        let mut evaluators = self.evaluators.watch();
        for names in [&mut actors, &mut learners, &mut evaluators] {
            names.mark_changed();
        }
        let mut beat = tokio::time::interval(BEAT);
        loop {
            tokio::select! {
                () = shutdown.cancelled() => return,
                sample = self.metrics.recv() => match sample {
                    Some(sample) => board.measured(sample),
                    None => return,
                },
                Some(names) = changed(&mut actors) => board.appeared(Role::Actor, names),
                Some(names) = changed(&mut learners) => board.appeared(Role::Learner, names),
                Some(names) = changed(&mut evaluators) => board.appeared(Role::Evaluator, names),
                _ = beat.tick() => board.beat(),
            }
        }
    }
}

/// The names after their next change; `None` when there will be none any more.
async fn changed(names: &mut watch::Receiver<BTreeSet<String>>) -> Option<BTreeSet<String>> {
    names.changed().await.ok()?;
    Some(names.borrow_and_update().clone())
}

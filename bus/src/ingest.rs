//! The learner's side of trajectories: decodes, drops duplicates, calls the handler, and answers.

mod names;
mod repeats;

use std::sync::Arc;

use tokio::sync::{mpsc, watch};
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::query::{Query, Queryable};

use self::names::Names;
use self::repeats::{Repeats, Seen};
use super::counters::IngestCounters;
use super::sender::{ACK_SCHEMA, REFUSAL_SCHEMA};
use super::{Bus, BusError};
use proto::codec::{Ack, Refusal, Refused, decode_trajectory, encode_ack, encode_refused};
use proto::metrics::IngestCounts;
use proto::{Trajectory, WeightsVersion, keys};
use tokio_util::task::AbortOnDropHandle;

/// Serves the trajectories of all actors until dropped.
#[derive(Debug)]
pub struct TrajectoryServer {
    counters: Arc<IngestCounters>,
    queryable: Queryable<()>,
    _worker: AbortOnDropHandle<()>,
    _open: Bus,
}

impl Bus {
    /// Serves trajectories from now on. A name belongs to the process whose trajectory is accepted first, for as long
    /// as a liveliness token of the name exists; other processes with the name are refused. `handler` is called once
    /// for each valid trajectory. It must not block, because all actors wait for it (use `try_send` on a bounded
    /// mailbox). Each answer contains `current_version`.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn serve_trajectories<F>(
        &self,
        handler: F,
        current_version: watch::Receiver<WeightsVersion>,
    ) -> Result<TrajectoryServer, BusError>
    where
        F: Fn(Trajectory) -> Result<(), Refusal> + Send + Sync + 'static,
    {
        let (queue, mut queries) = mpsc::channel::<Query>(self.config.ingest_queue);
        let counters = Arc::new(IngestCounters::default());
        let (names, repeats) = (Names::follow(self).await?, Repeats::default());
        let mut server = Server { handler, current_version, counters: counters.clone(), names, repeats };
        let (version, queue_counters) = (server.current_version.clone(), counters.clone());
        let queryable = self
            .session
            .declare_queryable(keys::INGEST_ALL)
            .complete(true)
            .callback(move |query| {
                queue_counters.received.add_one();
                if let Err(mpsc::error::TrySendError::Full(query) | mpsc::error::TrySendError::Closed(query)) =
                    queue.try_send(query)
                {
                    queue_counters.full.add_one();
                    answer(&query, Err(Refusal::Full), *version.borrow());
                }
            })
            .await
            .map_err(BusError::during("declaring the learner's ingest"))?;
        let worker = AbortOnDropHandle::new(tokio::spawn(async move {
            while let Some(query) = queries.recv().await {
                let decision = server.decide(&query);
                let version = *server.current_version.borrow();
                answer(&query, decision, version);
            }
        }));
        Ok(TrajectoryServer { counters, queryable, _worker: worker, _open: self.clone() })
    }
}

impl TrajectoryServer {
    /// Returns the number of trajectories so far, by result.
    pub fn counts(&self) -> IngestCounts {
        self.counters.counts()
    }

    /// Stops the server: actors see at once that no learner is present.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn close(self) -> Result<(), BusError> {
        self.queryable.undeclare().await.map_err(BusError::during("withdrawing the learner's ingest"))
    }
}

struct Server<F> {
    handler: F,
    current_version: watch::Receiver<WeightsVersion>,
    counters: Arc<IngestCounters>,
    names: Names,
    repeats: Repeats,
}

impl<F: Fn(Trajectory) -> Result<(), Refusal>> Server<F> {
    /// Decides on one message and counts the decision.
    fn decide(&mut self, query: &Query) -> Result<(), Refusal> {
        let decision = self.accept(query);
        match &decision {
            Ok(Taken::Now) => self.counters.accepted.add_one(),
            Ok(Taken::Before) => self.counters.duplicates.add_one(),
            Err(Refusal::Stale) => self.counters.stale.add_one(),
            Err(Refusal::Full) => self.counters.full.add_one(),
            Err(Refusal::NameTaken) => self.counters.name_taken.add_one(),
            Err(Refusal::Invalid(reason)) => {
                tracing::debug!(key = %query.key_expr(), reason, "invalid trajectory");
                self.counters.invalid.add_one();
            }
        }
        decision.map(drop)
    }

    fn accept(&mut self, query: &Query) -> Result<Taken, Refusal> {
        let payload = query.payload().map(|payload| payload.to_bytes()).unwrap_or_default();
        let trajectory = decode_trajectory(&payload).map_err(|error| Refusal::Invalid(error.to_string()))?;
        let key = query.key_expr().as_str();
        if key.strip_prefix(keys::INGEST_PREFIX) != Some(trajectory.actor.as_str()) {
            // The router grants keys by actor, so a message must not come from a different actor than its key.
            return Err(Refusal::Invalid(format!("actor {} may not send to {key}", trajectory.actor)));
        }
        if self.names.is_taken(&trajectory.actor, trajectory.epoch) {
            return Err(Refusal::NameTaken);
        }
        let id = (trajectory.actor.clone(), trajectory.epoch);
        let seq = trajectory.seq;
        match self.repeats.look_up(&id, seq) {
            Seen::Taken => return Ok(Taken::Before),
            Seen::Forgotten => return Err(Refusal::Stale),
            Seen::New => {}
        }
        (self.handler)(trajectory)?;
        let (actor, epoch) = &id;
        self.names.claim(actor, *epoch);
        // Remember only accepted trajectories, so that a retry after `Full` counts as a first attempt.
        self.repeats.remember(id, seq);
        Ok(Taken::Now)
    }
}

enum Taken {
    Now,
    Before,
}

/// Sends the answer. Does nothing if the actor is gone.
fn answer(query: &Query, decision: Result<(), Refusal>, weights_version: WeightsVersion) {
    let protobuf = |schema: &str| Encoding::APPLICATION_PROTOBUF.with_schema(schema);
    let sent = match decision {
        Ok(()) => {
            let ack = encode_ack(Ack { weights_version });
            query.reply(query.key_expr().clone(), ack).encoding(protobuf(ACK_SCHEMA)).wait()
        }
        Err(refusal) => {
            let refused = encode_refused(&Refused { refusal, weights_version });
            query.reply_err(refused).encoding(protobuf(REFUSAL_SCHEMA)).wait()
        }
    };
    if let Err(error) = sent {
        tracing::debug!(key = %query.key_expr(), %error, "the answer to a trajectory was not sent");
    }
}

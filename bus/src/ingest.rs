//! The learner's side of trajectories: decodes, drops duplicates, calls the handler, and answers.

mod names;
mod repeats;

use std::sync::Arc;

use parking_lot::Mutex;
use tokio::sync::{mpsc, watch};
use zenoh::Wait;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::query::{Query, Queryable};

use self::names::Names;
use self::repeats::{Repeats, Seen};
use super::refusals::Refusals;
use super::sender::ACK_SCHEMA;
use super::{Bus, BusError};
use proto::codec::{Refusal, TRAJECTORY_HEADER_BYTES, decode_trajectory, encode_ack, trajectory_actor};
use proto::metrics::IngestCounts;
use proto::{Trajectory, WeightsVersion, keys};
use tokio_util::task::AbortOnDropHandle;

/// Maximum number of trajectories that wait to be decoded; more are refused as `Full`.
const INGEST_QUEUE: usize = 256;

/// Serves the trajectories of all actors until dropped; they then see at once that no learner is present.
#[derive(Debug)]
pub struct TrajectoryServer {
    counts: Arc<Mutex<IngestCounts>>,
    _queryable: Queryable<()>,
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
    pub async fn serve_trajectories(
        &self,
        handler: impl Fn(Trajectory) -> Result<(), Refusal> + Send + Sync + 'static,
        current_version: watch::Receiver<WeightsVersion>,
    ) -> Result<TrajectoryServer, BusError> {
        let (queue, mut queries) = mpsc::channel::<Query>(INGEST_QUEUE);
        let counts: Arc<Mutex<IngestCounts>> = Arc::default();
        let names = Names::follow(self).await?;
        let refusals = Refusals::start();
        let inlet =
            Inlet { queue, counts: counts.clone(), refusals: refusals.clone(), version: current_version.clone() };
        let mut server = Server { handler, counts: counts.clone(), names, repeats: Repeats::default() };
        let declared = self.session.declare_queryable(keys::INGEST_ALL).complete(true);
        let declared = declared.callback(move |query| inlet.pass(query)).await;
        let queryable = declared.map_err(BusError::during("declaring the learner's ingest"))?;
        let worker = AbortOnDropHandle::new(tokio::spawn(async move {
            while let Some(query) = queries.recv().await {
                let decision = server.decide(&query);
                let newest = *current_version.borrow();
                match decision {
                    Ok(()) => acknowledge(&query, newest),
                    Err(refusal) => refusals.refuse_in_turn(query, &refusal, newest).await,
                }
            }
        }));
        Ok(TrajectoryServer { counts, _queryable: queryable, _worker: worker, _open: self.clone() })
    }
}

impl TrajectoryServer {
    /// Returns the number of trajectories so far, by result.
    pub fn counts(&self) -> IngestCounts {
        *self.counts.lock()
    }
}

/// Turns away what is not worth decoding.
struct Inlet {
    queue: mpsc::Sender<Query>,
    counts: Arc<Mutex<IngestCounts>>,
    refusals: Refusals,
    version: watch::Receiver<WeightsVersion>,
}

impl Inlet {
    fn pass(&self, query: Query) {
        self.counts.lock().received_total += 1;
        let (query, refusal) = match check_header(&query) {
            Err(reason) => {
                count_invalid(&mut self.counts.lock(), &query, &reason);
                (query, Refusal::Invalid(reason))
            }
            Ok(()) => {
                let Err(unsent) = self.queue.try_send(query) else { return };
                self.counts.lock().full_total += 1;
                (unsent.into_inner(), Refusal::Full)
            }
        };
        self.refusals.refuse(query, &refusal, *self.version.borrow());
    }
}

/// Checks the first bytes: the protocol's version, and the actor, who must be that of the key.
fn check_header(query: &Query) -> Result<(), String> {
    let slices = query.payload().into_iter().flat_map(ZBytes::slices);
    let header: Vec<u8> = slices.flatten().copied().take(TRAJECTORY_HEADER_BYTES).collect();
    let actor = trajectory_actor(&header).map_err(|error| error.to_string())?;
    check_key(query, actor)
}

/// Checks that a message comes from the actor of its key: the router grants keys by actor.
fn check_key(query: &Query, actor: &str) -> Result<(), String> {
    let key = query.key_expr().as_str();
    let is_own = key.strip_prefix(keys::INGEST_PREFIX) == Some(actor);
    if is_own { Ok(()) } else { Err(format!("actor {actor} may not send to {key}")) }
}

/// Counts an invalid message, and logs the first.
fn count_invalid(counts: &mut IngestCounts, query: &Query, reason: &str) {
    let key = query.key_expr();
    counts.invalid_total += 1;
    if counts.invalid_total == 1 {
        tracing::warn!(%key, reason, "an invalid trajectory was refused; more are only counted");
    } else {
        tracing::debug!(%key, reason, "invalid trajectory");
    }
}

struct Server<F> {
    handler: F,
    counts: Arc<Mutex<IngestCounts>>,
    names: Names,
    repeats: Repeats,
}

impl<F: Fn(Trajectory) -> Result<(), Refusal>> Server<F> {
    /// Decides on one message and counts the decision.
    fn decide(&mut self, query: &Query) -> Result<(), Refusal> {
        let decision = self.accept(query);
        let mut counts = self.counts.lock();
        match &decision {
            Ok(Taken::Now) => counts.accepted_total += 1,
            Ok(Taken::Before) => counts.duplicates_total += 1,
            Err(Refusal::Stale) => counts.stale_total += 1,
            Err(Refusal::Full) => counts.full_total += 1,
            Err(Refusal::NameTaken) => counts.name_taken_total += 1,
            Err(Refusal::Invalid(reason)) => count_invalid(&mut counts, query, reason),
        }
        decision.map(drop)
    }

    fn accept(&mut self, query: &Query) -> Result<Taken, Refusal> {
        let payload = query.payload().map(|payload| payload.to_bytes()).unwrap_or_default();
        let trajectory = decode_trajectory(&payload).map_err(|error| Refusal::Invalid(error.to_string()))?;
        // A message can name a second actor after its header.
        check_key(query, trajectory.actor.as_str()).map_err(Refusal::Invalid)?;
        if self.names.lock().is_taken(&trajectory.actor, trajectory.epoch) {
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
        self.names.lock().claim(actor, *epoch);
        // Remember only accepted trajectories, so that a retry after `Full` counts as a first attempt.
        self.repeats.remember(id, seq);
        Ok(Taken::Now)
    }
}

enum Taken {
    Now,
    Before,
}

/// Acknowledges a trajectory. Does nothing if the actor is gone.
fn acknowledge(query: &Query, newest: WeightsVersion) {
    let encoding = Encoding::APPLICATION_PROTOBUF.with_schema(ACK_SCHEMA);
    if let Err(error) = query.reply(query.key_expr().clone(), encode_ack(newest)).encoding(encoding).wait() {
        tracing::debug!(key = %query.key_expr(), %error, "the answer to a trajectory was not sent");
    }
}

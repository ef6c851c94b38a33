//! Distributed evaluation: a unit of episodes is a query to a remote worker, which answers with the results.

use std::time::Duration;

use tokio::sync::mpsc;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, Querier, Query, Queryable};

use super::{Bus, BusError};
use proto::codec::{MAX_UNIT_BYTES, decode_answer, decode_unit, encode_answer, encode_unit};
use proto::keys;
use proto::unit::{EvalAnswer, EvalUnit};

/// Sends units to one remote worker.
#[derive(Debug)]
pub struct WorkerCaller {
    querier: Querier<'static>,
    _open: Bus,
}

/// Receives units at a remote worker, one at a time.
#[derive(Debug)]
pub struct UnitServer {
    calls: mpsc::Receiver<Query>,
    _queryable: Queryable<()>,
    open: Bus,
}

/// A unit that waits for its answer; if dropped unanswered, the evaluator assigns it to another worker.
#[derive(Debug)]
pub struct UnitCall {
    /// The episodes to run.
    pub unit: EvalUnit,
    query: Query,
}

/// Reasons why a unit was not run.
#[derive(Debug, thiserror::Error)]
pub enum CallError {
    /// The remote worker is gone or busy.
    #[error("no answer")]
    NoAnswer,
    /// The remote worker did not answer in time.
    #[error("no answer in time")]
    TooLate,
    /// The answer breaks a rule.
    #[error("invalid answer: {0}")]
    Invalid(#[from] proto::DecodeError),
    /// The unit is larger than a remote worker accepts.
    #[error("a unit of {0} bytes is too large")]
    TooLarge(usize),
}

impl Bus {
    /// Declares the caller of the remote worker with this name, which waits for answers for up to `patience`. A worker
    /// that ends is noticed sooner.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn worker_caller(&self, worker: &str, patience: Duration) -> Result<WorkerCaller, BusError> {
        let key = keys::worker(worker);
        let querier = self
            .session
            .declare_querier(key.clone())
            .congestion_control(CongestionControl::Block)
            .priority(Priority::DataLow)
            .consolidation(ConsolidationMode::None)
            .timeout(patience)
            .await
            .map_err(BusError::during(format!("declaring {key}")))?;
        Ok(WorkerCaller { querier, _open: self.clone() })
    }

    /// Receives units under this name from now on.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn serve_units(&self, worker: &str) -> Result<UnitServer, BusError> {
        let key = keys::worker(worker);
        // One unit can wait while another runs, so that two evaluators take turns.
        let (queue, calls) = mpsc::channel::<Query>(1);
        let counters = self.counters.clone();
        let queryable = self
            .session
            .declare_queryable(key.clone())
            .complete(true)
            .callback(move |query| {
                // Dropping a query ends it without a reply.
                if queue.try_send(query).is_err() {
                    counters.queries_dropped.add_one();
                }
            })
            .await
            .map_err(BusError::during(format!("declaring {key}")))?;
        Ok(UnitServer { calls, _queryable: queryable, open: self.clone() })
    }
}

impl WorkerCaller {
    /// Sends a unit to be run and waits for the results.
    ///
    /// # Errors
    /// If there is no answer, or it is invalid.
    pub async fn run(&self, unit: &EvalUnit) -> Result<EvalAnswer, CallError> {
        let bytes = encode_unit(unit);
        if bytes.len() > MAX_UNIT_BYTES {
            return Err(CallError::TooLarge(bytes.len()));
        }
        let encoding = Encoding::APPLICATION_PROTOBUF.with_schema("lodestone.v1.EvalUnit");
        let sent = self.querier.get().payload(bytes).encoding(encoding).await;
        let replies = sent.map_err(|_| CallError::NoAnswer)?;
        let reply = replies.recv_async().await.map_err(|_| CallError::NoAnswer)?;
        // Workers send no errors of their own; zenoh does after the timeout.
        let sample = reply.result().map_err(|_| CallError::TooLate)?;
        Ok(decode_answer(&sample.payload().to_bytes())?)
    }
}

impl UnitServer {
    /// Returns the next unit; `None` after the session is closed. Invalid units are refused and counted.
    pub async fn recv(&mut self) -> Option<UnitCall> {
        loop {
            let query = self.calls.recv().await?;
            let payload = query.payload().map(|payload| payload.to_bytes()).unwrap_or_default();
            match decode_unit(&payload) {
                Ok(unit) => return Some(UnitCall { unit, query }),
                Err(error) => {
                    self.open.counters.queries_invalid.add_one();
                    let refusal = EvalAnswer::Refused(error.to_string());
                    // One after the other, so that a flood has no more than one thread.
                    UnitCall::send(query, refusal).await;
                }
            }
        }
    }
}

impl UnitCall {
    /// Sends the answer. Does nothing if the evaluator is gone.
    pub async fn answer(self, reply: EvalAnswer) {
        Self::send(self.query, reply).await;
    }

    async fn send(query: Query, reply: EvalAnswer) {
        let sent = tokio::task::spawn_blocking(move || answer(&query, &reply)).await;
        if let Err(panic) = sent {
            tracing::warn!(%panic, "answering a unit failed");
        }
    }
}

fn answer(query: &Query, reply: &EvalAnswer) {
    let encoding = Encoding::APPLICATION_PROTOBUF.with_schema("lodestone.v1.EvalAnswer");
    if let Err(error) = query.reply(query.key_expr().clone(), encode_answer(reply)).encoding(encoding).wait() {
        tracing::debug!(key = %query.key_expr(), %error, "the answer to a unit was not sent");
    }
}

//! A key that serves its newest value to queries.

use parking_lot::Mutex;
use std::sync::Arc;

use tokio::sync::mpsc;
use zenoh::Wait;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::query::{Query, Queryable};

use super::sender::REFUSAL_SCHEMA;
use super::{Bus, BusError};
use proto::WeightsVersion;
use proto::codec::{Refusal, Refused, encode_refused};
use tokio_util::task::AbortOnDropHandle;

/// Maximum number of waiting queries.
const QUEUE: usize = 1024;

/// Answers queries on one key with the newest value; gives no reply before there is one.
#[derive(Debug)]
pub(super) struct Latest {
    value: Arc<Mutex<Option<ZBytes>>>,
    _queryable: Queryable<()>,
    _worker: AbortOnDropHandle<()>,
    _open: Bus,
}

impl Latest {
    pub(super) async fn declare(bus: &Bus, key: String, encoding: Encoding) -> Result<Self, BusError> {
        let (queue, mut queries) = mpsc::channel::<Query>(QUEUE);
        let counters = bus.counters.clone();
        let queryable = bus
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
        let value: Arc<Mutex<Option<ZBytes>>> = Arc::default();
        let (shared, counters) = (value.clone(), bus.counters.clone());
        let worker = AbortOnDropHandle::new(tokio::spawn(async move {
            while let Some(query) = queries.recv().await {
                if query.payload().is_some_and(|payload| !payload.is_empty()) {
                    counters.queries_invalid.add_one();
                    refuse(&query);
                    continue;
                }
                let Some(value) = lock(&shared).clone() else { continue };
                let (key, encoding) = (key.clone(), encoding.clone());
                // Sending megabytes to a slow reader can block, and must not delay other answers.
                tokio::task::spawn_blocking(move || {
                    if let Err(error) = query.reply(&key, value).encoding(encoding).wait() {
                        tracing::debug!(key, %error, "an answer was not sent");
                    }
                });
            }
        }));
        Ok(Self { value, _queryable: queryable, _worker: worker, _open: bus.clone() })
    }

    pub(super) fn set(&self, value: ZBytes) {
        *lock(&self.value) = Some(value);
    }
}

fn refuse(query: &Query) {
    let refusal = Refusal::Invalid(format!("a query for {} has no payload", query.key_expr()));
    let refused = Refused { refusal, weights_version: WeightsVersion::default() };
    let encoding = Encoding::APPLICATION_PROTOBUF.with_schema(REFUSAL_SCHEMA);
    if let Err(error) = query.reply_err(encode_refused(&refused)).encoding(encoding).wait() {
        tracing::debug!(key = %query.key_expr(), %error, "a refusal was not sent");
    }
}

fn lock(value: &Mutex<Option<ZBytes>>) -> parking_lot::MutexGuard<'_, Option<ZBytes>> {
    // The lock is held only to copy or replace the value, so a panic elsewhere cannot leave it inconsistent.
    value.lock()
}

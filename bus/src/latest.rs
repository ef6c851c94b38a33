//! A key that serves its newest value to queries.

use parking_lot::Mutex;
use std::sync::Arc;

use tokio::sync::mpsc;
use tokio::time::{Duration, Instant};
use zenoh::Wait;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::query::{Query, Queryable};

use super::sender::REFUSAL_SCHEMA;
use super::{Bus, BusError};
use proto::WeightsVersion;
use proto::codec::{Refusal, Refused, encode_refused};
use tokio_util::task::AbortOnDropHandle;

/// Maximum number of waiting queries: as many as a router has sessions.
const QUEUE: usize = 8192;

/// How far answers may run ahead of the rate.
const BURST: Duration = Duration::from_secs(1);

/// Answers queries on one key with the newest value. Sends no reply before there is one.
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
        let mut pace = Pace::new(bus.config.weights_mb_per_s, Instant::now());
        let worker = AbortOnDropHandle::new(tokio::spawn(async move {
            while let Some(query) = queries.recv().await {
                if query.payload().is_some_and(|payload| !payload.is_empty()) {
                    counters.queries_invalid.add_one();
                    refuse(&query);
                    continue;
                }
                tokio::time::sleep_until(pace.free_at()).await;
                let Some(value) = lock(&shared).clone() else { continue };
                pace.add(value.len(), Instant::now());
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

/// Spreads answers over time, so that their bytes stay below a rate.
#[derive(Debug)]
struct Pace {
    bytes_per_s: f64,
    /// Time at which all answers so far have been sent at the rate.
    end: Instant,
}

impl Pace {
    fn new(mb_per_s: u64, now: Instant) -> Self {
        Self { bytes_per_s: mb_per_s as f64 * 1e6, end: now }
    }

    /// Returns when the next answer may be sent.
    fn free_at(&self) -> Instant {
        self.end.checked_sub(BURST).unwrap_or(self.end)
    }

    /// Counts an answer that is being sent now.
    fn add(&mut self, n_bytes: usize, now: Instant) {
        self.end = self.end.max(now) + Duration::from_secs_f64(n_bytes as f64 / self.bytes_per_s);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_of_one_second_go_at_once_and_later_ones_wait_for_their_turn() {
        // At 10 MB/s an answer of 5 MB takes half a second.
        let start = Instant::now();
        let (mut now, mut pace) = (start, Pace::new(10, start));
        let mut sent_at = Vec::new();
        for _ in 0..5 {
            now = now.max(pace.free_at());
            pace.add(5_000_000, now);
            sent_at.push((now - start).as_millis());
        }
        assert_eq!(sent_at, [0, 0, 0, 500, 1000]);
    }

    #[test]
    fn a_pause_gives_back_no_more_than_one_second() {
        let start = Instant::now();
        let mut pace = Pace::new(10, start);
        let now = start + Duration::from_secs(60);
        (0..3).for_each(|_| pace.add(5_000_000, now));
        assert_eq!(pace.free_at() - now, Duration::from_millis(500));
    }
}

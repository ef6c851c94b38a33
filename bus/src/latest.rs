//! A key that serves its newest value to queries.

use parking_lot::Mutex;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use tokio::sync::{Semaphore, mpsc};
use tokio::time::{Duration, Instant};
use zenoh::Wait;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::query::{Query, Queryable};

use super::refusals::Refusals;
use super::turns::Turns;
use super::{Bus, BusError};
use proto::codec::Refusal;
use proto::metrics::BusCounts;
use tokio_util::task::AbortOnDropHandle;

/// Maximum number of waiting queries: as many as a router has sessions.
const QUEUE: usize = 8192;

/// Maximum number of answers that are being sent. Each has a thread, which a slow reader can hold for seconds.
const SENDERS: usize = 32;

/// How far answers may run ahead of the rate.
const BURST: Duration = Duration::from_secs(1);

/// Least time between two queries of a session: ten times what a router demands.
const QUERY_PERIOD: Duration = Duration::from_millis(50);

/// The parameter of a query in which its sender names itself.
const NAME: &str = "session";

/// Answers queries on one key with the newest value. Sends no reply before there is one.
#[derive(Debug)]
pub(super) struct Latest {
    desk: Arc<Desk>,
    _queryable: Queryable<()>,
    _worker: AbortOnDropHandle<()>,
    _open: Bus,
}

/// What the callback and the sending task share.
#[derive(Debug)]
struct Desk {
    state: Mutex<State>,
    counts: Arc<Mutex<BusCounts>>,
}

#[derive(Debug)]
struct State {
    /// All answers share its buffer.
    value: Option<ZBytes>,
    /// Number of the value.
    number: u64,
    turns: Turns,
}

impl Bus {
    /// Returns a new sender of queries to [`Latest`].
    pub(super) fn asker(&self) -> Asker {
        let name = format!("{NAME}={}-{}", self.session.zid(), self.n_askers.fetch_add(1, Ordering::Relaxed));
        Asker { name, next_query: self.next_query.clone() }
    }
}

/// A sender of queries to [`Latest`], with a name of its own.
#[derive(Debug)]
pub(super) struct Asker {
    name: String,
    /// Time of the session's next query.
    next_query: Arc<Mutex<Instant>>,
}

impl Asker {
    /// Waits until the session may send another query, and returns the parameters that name the sender.
    pub(super) async fn turn(&self) -> &str {
        tokio::time::sleep_until(self.next_turn()).await;
        &self.name
    }

    fn next_turn(&self) -> Instant {
        let mut next_query = self.next_query.lock();
        let turn = Instant::now().max(*next_query);
        *next_query = turn + QUERY_PERIOD;
        turn
    }
}

impl Latest {
    pub(super) async fn declare(bus: &Bus, key: String, encoding: Encoding) -> Result<Self, BusError> {
        let (queue, queries) = mpsc::channel::<Query>(QUEUE);
        let state = State { value: None, number: 0, turns: Turns::new(Instant::now()) };
        let desk = Arc::new(Desk { state: Mutex::new(state), counts: bus.counts.clone() });
        let shared = desk.clone();
        let refusals = Refusals::start();
        let declared = bus.session.declare_queryable(key.clone()).complete(true).callback(move |query| {
            if let Some((query, refusal)) = shared.admit(query, &queue) {
                refusals.refuse(query, &refusal, Default::default());
            }
        });
        let queryable = declared.await.map_err(BusError::during(format!("declaring {key}")))?;
        let pace = Pace::new(bus.config.weights_mb_per_s, Instant::now());
        let worker = AbortOnDropHandle::new(tokio::spawn(answer_all(desk.clone(), queries, pace, key, encoding)));
        Ok(Self { desk, _queryable: queryable, _worker: worker, _open: bus.clone() })
    }

    pub(super) fn set(&self, value: ZBytes) {
        let mut state = self.desk.state.lock();
        state.value = Some(value);
        state.number += 1;
    }
}

impl Desk {
    /// Puts a query into the queue, or returns it and why it is refused. Counts refusals.
    fn admit(&self, query: Query, queue: &mpsc::Sender<Query>) -> Option<(Query, Refusal)> {
        if query.payload().is_some_and(|payload| !payload.is_empty()) {
            self.counts.lock().queries_invalid_total += 1;
            let refusal = Refusal::Invalid(format!("a query for {} has no payload", query.key_expr()));
            return Some((query, refusal));
        }
        let mut state = self.state.lock();
        let number = state.number;
        let mut refused = query;
        if state.turns.admit(name(&refused), number, Instant::now()) {
            let Err(unsent) = queue.try_send(refused) else { return None };
            refused = unsent.into_inner();
            state.turns.end(name(&refused), None, Instant::now());
        }
        drop(state);
        let mut counts = self.counts.lock();
        counts.queries_dropped_total += 1;
        if counts.queries_dropped_total == 1 {
            let key = refused.key_expr();
            tracing::warn!(%key, "a query was refused, because too many come; more are only counted");
        }
        Some((refused, Refusal::Full))
    }

    /// Ends a query's wait and returns its answer, if there is a value yet.
    fn take_turn(&self, query: &Query) -> Option<ZBytes> {
        let mut state = self.state.lock();
        let number = state.value.is_some().then_some(state.number);
        state.turns.end(name(query), number, Instant::now());
        state.value.clone()
    }
}

/// Returns the name that the sender of a query gives itself.
fn name(query: &Query) -> Option<&str> {
    query.parameters().get(NAME).filter(|name| (1..=64).contains(&name.len()))
}

async fn answer_all(
    desk: Arc<Desk>,
    mut queries: mpsc::Receiver<Query>,
    mut pace: Pace,
    key: String,
    encoding: Encoding,
) {
    let senders = Arc::new(Semaphore::new(SENDERS));
    while let Some(query) = queries.recv().await {
        tokio::time::sleep_until(pace.free_at()).await;
        let Ok(sender) = senders.clone().acquire_owned().await else { return };
        let Some(value) = desk.take_turn(&query) else { continue };
        pace.add(value.len(), Instant::now());
        let (key, encoding) = (key.clone(), encoding.clone());
        // Sending megabytes to a slow reader can block, and must not delay other answers.
        tokio::task::spawn_blocking(move || {
            if let Err(error) = query.reply(&key, value).encoding(encoding).wait() {
                tracing::debug!(key, %error, "an answer was not sent");
            }
            drop(sender);
        });
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

#[cfg(test)]
mod tests {
    use proto::Valid;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    /// Queries in one process pass no router, so that all of them arrive.
    #[tokio::test(flavor = "multi_thread")]
    async fn of_many_queries_at_once_few_are_answered_from_one_buffer_and_the_rest_is_refused() {
        const N_FLOOD: usize = 10_000;
        let bus = Bus::open(&Valid::default()).await.unwrap();
        let latest = Latest::declare(&bus, "key".to_owned(), Encoding::default()).await.unwrap();
        latest.set(ZBytes::from(vec![7; 1_000_000]));
        let buffers = Arc::new(Mutex::new(Vec::new()));
        let n_refused = Arc::new(AtomicUsize::new(0));
        let (open, mut ended) = mpsc::channel::<()>(1);
        for _ in 0..N_FLOOD {
            let (buffers, n_refused, open) = (buffers.clone(), n_refused.clone(), open.clone());
            let take = move |reply: zenoh::query::Reply| {
                // Zenoh drops the callback, and with it `open`, when the query has ended.
                let _open = &open;
                match reply.result() {
                    Ok(sample) => buffers.lock().extend(sample.payload().slices().map(|slice| slice.as_ptr() as usize)),
                    Err(_) => drop(n_refused.fetch_add(1, Ordering::Relaxed)),
                }
            };
            bus.session.get("key").callback(take).await.unwrap();
        }
        drop(open);
        assert_eq!(ended.recv().await, None);
        let buffers = buffers.lock().clone();
        // `turns` checks the exact number, which grows with time.
        assert!((1..N_FLOOD / 10).contains(&buffers.len()), "{}", buffers.len());
        assert!(buffers.iter().all(|&buffer| buffer == buffers[0]));
        assert_eq!(bus.counts().queries_dropped_total as usize + buffers.len(), N_FLOOD);
        let n_refused = n_refused.load(Ordering::Relaxed);
        assert!((1..=N_FLOOD - buffers.len()).contains(&n_refused), "{n_refused}");
        bus.close().await;
    }

    #[test]
    fn answers_of_one_second_go_at_once_and_later_ones_wait_for_their_turn() {
        // At 10 MB/s an answer of 5 MB takes half a second.
        let start = Instant::now();
        let mut now = start;
        let mut pace = Pace::new(10, start);
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

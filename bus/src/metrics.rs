//! Metrics and the history of evaluations as JSON, so that any zenoh client can read them without our schema.

use std::sync::{Arc, Weak};

use parking_lot::Mutex;
use serde::Serialize;
use tokio::sync::mpsc;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, QueryTarget};
use zenoh::sample::Sample;

use super::latest::{Asker, Latest};
use super::{Bus, BusError};
use proto::keys;
use proto::metrics::BusCounts;

/// Maximum number of samples that wait for a reader.
const QUEUE: usize = 4096;

/// Publishes the metrics of one key and answers queries for the latest.
#[derive(Debug)]
pub struct MetricsPublisher {
    latest: Latest,
    publisher: Publisher<'static>,
}

/// Answers queries for [`keys::HISTORY_EVAL`] with JSON.
#[derive(Debug)]
pub struct HistoryAnswer(Latest);

/// Receives the metrics of some keys.
#[derive(Debug)]
pub struct MetricsSubscriber {
    samples: mpsc::Receiver<MetricsSample>,
    key: String,
    asker: Asker,
    /// Weak, so that the queue ends once the session has dropped its callbacks.
    inbox: Weak<Inbox>,
    _subscriber: Subscriber<()>,
    bus: Bus,
}

/// One metrics value.
#[derive(Clone, Debug, PartialEq)]
pub struct MetricsSample {
    /// Key after `metrics/`, for example `learner`.
    pub suffix: String,
    /// The published value.
    pub value: serde_json::Value,
}

impl Bus {
    /// Publishes metrics under `metrics/<suffix>`; see [`keys`] for the suffixes.
    ///
    /// # Errors
    /// If the suffix is not a valid key or the session is closed.
    pub async fn metrics_publisher(&self, suffix: &str) -> Result<MetricsPublisher, BusError> {
        let key = keys::metrics(suffix);
        let latest = Latest::declare(self, key.clone(), Encoding::APPLICATION_JSON).await?;
        let publisher = self
            .session
            .declare_publisher(key.clone())
            .congestion_control(CongestionControl::Drop)
            .priority(Priority::Data)
            .encoding(Encoding::APPLICATION_JSON)
            .await
            .map_err(BusError::during(format!("declaring {key}")))?;
        Ok(MetricsPublisher { latest, publisher })
    }

    /// Answers queries for the history from now on. Sends no reply before the first [`HistoryAnswer::set`].
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn history_answer(&self) -> Result<HistoryAnswer, BusError> {
        Ok(HistoryAnswer(Latest::declare(self, keys::HISTORY_EVAL.to_owned(), Encoding::APPLICATION_JSON).await?))
    }

    /// Receives the latest metrics of each existing key and all metrics from now on. `suffix` may have wildcards: `**`
    /// for all, `actor/*` for all actors.
    ///
    /// # Errors
    /// If the suffix is not a valid key expression or the session is closed.
    pub async fn metrics_subscriber(&self, suffix: &str) -> Result<MetricsSubscriber, BusError> {
        let key = keys::metrics(suffix);
        let (sender, samples) = mpsc::channel(QUEUE);
        let inbox = Arc::new(Inbox { sender, counts: self.counts.clone() });
        let live = inbox.clone();
        let declared = self.session.declare_subscriber(key.clone()).callback(move |sample| live.push(&sample)).await;
        let subscriber = declared.map_err(BusError::during(format!("subscribing to {key}")))?;
        let inbox = Arc::downgrade(&inbox);
        let asker = self.asker();
        let subscriber = MetricsSubscriber { samples, key, asker, inbox, _subscriber: subscriber, bus: self.clone() };
        // Query after subscribing, so that no value is missed; a value may arrive twice.
        subscriber.ask_latest().await?;
        Ok(subscriber)
    }
}

impl MetricsPublisher {
    /// Publishes `metrics` and keeps them as the latest, even without subscribers.
    ///
    /// # Errors
    /// If they cannot be serialized as JSON or the session is closed.
    pub async fn put(&self, metrics: &impl Serialize) -> Result<(), BusError> {
        let key = self.publisher.key_expr().as_str();
        let payload = json(key, metrics)?;
        self.latest.set(payload.clone());
        self.publisher.put(payload).await.map_err(BusError::during(format!("putting {key}")))
    }
}

impl HistoryAnswer {
    /// Sets the answer.
    ///
    /// # Errors
    /// If the history cannot be serialized as JSON.
    pub fn set(&self, history: &impl Serialize) -> Result<(), BusError> {
        self.0.set(json(keys::HISTORY_EVAL, history)?);
        Ok(())
    }
}

impl MetricsSubscriber {
    /// Asks for the latest value of each key again. A publisher that has reconnected may have nothing new for a long
    /// time.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn ask_latest(&self) -> Result<(), BusError> {
        let selector = format!("{}?{}", self.key, self.asker.turn().await);
        let Some(inbox) = self.inbox.upgrade() else { return Ok(()) };
        let query = self.bus.session.get(selector).target(QueryTarget::All);
        // Otherwise replies wait for the slowest publisher, and then overwrite what was published meanwhile.
        let query = query.consolidation(ConsolidationMode::None).callback(move |reply| {
            if let Ok(sample) = reply.result() {
                inbox.push(sample);
            }
        });
        query.await.map_err(BusError::during(format!("asking for {}", self.key)))
    }

    /// Returns the next value; `None` after the session is closed.
    pub async fn recv(&mut self) -> Option<MetricsSample> {
        self.samples.recv().await
    }
}

#[derive(Debug)]
struct Inbox {
    sender: mpsc::Sender<MetricsSample>,
    counts: Arc<Mutex<BusCounts>>,
}

impl Inbox {
    fn push(&self, sample: &Sample) {
        // Reserve a slot first: what will be dropped need not be parsed.
        let Ok(slot) = self.sender.try_reserve() else {
            self.counts.lock().metrics_dropped_total += 1;
            return;
        };
        let Ok(value) = serde_json::from_slice(&sample.payload().to_bytes()) else {
            self.counts.lock().metrics_invalid_total += 1;
            tracing::debug!(key = %sample.key_expr(), "metrics that are not JSON");
            return;
        };
        let key = sample.key_expr().as_str();
        let suffix = key.strip_prefix(&keys::metrics("")).unwrap_or(key).to_owned();
        slot.send(MetricsSample { suffix, value });
    }
}

fn json(key: &str, value: &impl Serialize) -> Result<ZBytes, BusError> {
    let json = serde_json::to_vec(value);
    Ok(ZBytes::from(json.map_err(|error| BusError::during(format!("writing {key} as JSON"))(error.into()))?))
}

//! Weights: the learner publishes a notice of newer weights, and the other processes pull them.

use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use parking_lot::Mutex;
use tokio::sync::watch;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::handlers::{RingChannel, RingChannelHandler};
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, Querier};
use zenoh::sample::Sample;

use super::latest::{Asker, Latest};
use super::matching::Matching;
use super::sender::REFUSAL_SCHEMA;
use super::{Bus, BusError, Followed, unix_ms};
use proto::codec::{
    MAX_WEIGHTS_BYTES, PublishedWeights, WeightsNotice, decode_notice, decode_weights, encode_notice, encode_weights,
};
use proto::metrics::BusCounts;
use proto::{Weights, keys};
use tokio_util::task::AbortOnDropHandle;

const WEIGHTS_SCHEMA: &str = "lodestone.v1.Weights";
const NOTICE_SCHEMA: &str = "lodestone.v1.WeightsNotice";

/// Timeout for a pull of the weights.
const PULL_TIMEOUT: Duration = Duration::from_secs(60);

/// Interval between repetitions of the newest notice: the network drops notices rather than wait.
const NOTICE_PERIOD: Duration = Duration::from_secs(2);

/// Pause before a failed pull is retried.
const RETRY_PAUSE: Duration = Duration::from_millis(500);

/// Pause between pulls while there is no reply or the learner refuses them, at least and at most. A learner sends a
/// notice when it gets its first weights, so this matters only for a lost pull; thousands of actors may be waiting like
/// this. Their pauses differ, so that they do not come back all at once.
const NOTHING_PAUSE_MS: std::ops::Range<u64> = 1000..3000;

/// The learner's side: holds the newest weights and answers pulls.
#[derive(Debug)]
pub struct WeightsPublisher {
    epoch: u64,
    latest: Latest,
    notices: Arc<Publisher<'static>>,
    newest: Arc<Mutex<Option<WeightsNotice>>>,
    _repeater: AbortOnDropHandle<()>,
}

/// The side of actors and the evaluator: the newest weights that were pulled, or a value derived from them; `None`
/// before the first.
pub type WeightsSubscriber<T = Weights> = Followed<Option<Arc<T>>>;

impl Bus {
    /// Follows whether a learner of the run can be reached.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn learner_watch(&self) -> Result<Followed<bool>, BusError> {
        let querier = self.session.declare_querier(keys::WEIGHTS_LATEST).await;
        let querier = querier.map_err(BusError::during("looking for a learner"))?;
        let there = Matching::of(Arc::new(querier)).await?;
        Ok(Followed { value: there.watch(), _source: Box::new(there), _open: self.clone() })
    }

    /// Publishes weights under this process's own epoch. A run should have one publisher.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn weights_publisher(&self) -> Result<WeightsPublisher, BusError> {
        let encoding = Encoding::APPLICATION_PROTOBUF.with_schema(WEIGHTS_SCHEMA);
        let latest = Latest::declare(self, keys::WEIGHTS_LATEST.to_owned(), encoding).await?;
        let notices = self
            .session
            .declare_publisher(keys::WEIGHTS_VERSION_ALL)
            .congestion_control(CongestionControl::Drop)
            .priority(Priority::InteractiveHigh)
            .express(true)
            .encoding(Encoding::APPLICATION_PROTOBUF.with_schema(NOTICE_SCHEMA))
            .await
            .map_err(BusError::during("declaring the notices of weights"))?;
        let (notices, newest) = (Arc::new(notices), Arc::<Mutex<Option<WeightsNotice>>>::default());
        let (repeats, repeated) = (notices.clone(), newest.clone());
        let repeater = AbortOnDropHandle::new(tokio::spawn(async move {
            loop {
                tokio::time::sleep(NOTICE_PERIOD).await;
                let newest = repeated.lock().map(encode_notice);
                if let Some(notice) = newest {
                    // It fails if the session is closed, and then `publish` says so.
                    let _ = repeats.put(notice).await;
                }
            }
        }));
        // The time distinguishes a restarted learner from its predecessor.
        Ok(WeightsPublisher { epoch: unix_ms(), latest, notices, newest, _repeater: repeater })
    }

    /// Follows the newest weights from now on; a late joiner gets the current ones.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn weights_subscriber(&self) -> Result<WeightsSubscriber, BusError> {
        self.weights_subscriber_keeping(Some).await
    }

    /// Like [`Self::weights_subscriber`], but stores only the result of `keep`, which may block. If that is `None` or
    /// it panics, the weights count as refused, and the result before stays.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn weights_subscriber_keeping<T: Send + Sync + 'static>(
        &self,
        keep: impl Fn(Weights) -> Option<T> + Send + Sync + 'static,
    ) -> Result<WeightsSubscriber<T>, BusError> {
        let failed = || BusError::during("subscribing to weights");
        // Only the newest notice matters.
        let key = keys::weights_version(&self.session.zid().to_string());
        let notices = self.session.declare_subscriber(key).with(RingChannel::new(1)).await.map_err(failed())?;
        let querier = self
            .session
            .declare_querier(keys::WEIGHTS_LATEST)
            .congestion_control(CongestionControl::Block)
            .priority(Priority::DataHigh)
            .consolidation(ConsolidationMode::None)
            .timeout(PULL_TIMEOUT)
            .await
            .map_err(failed())?;
        let learner = Arc::new(querier);
        let learner_there = Matching::of(learner.clone()).await?;
        let (sender, weights) = watch::channel(None);
        let (counts, asker, keep) = (self.counts.clone(), self.asker(), Arc::new(keep));
        let puller = Puller { learner, learner_there, asker, notices, counts, held: None, told: None, keep, sender };
        let worker = AbortOnDropHandle::new(tokio::spawn(puller.run()));
        Ok(Followed { value: weights, _source: Box::new(worker), _open: self.clone() })
    }
}

impl WeightsPublisher {
    /// Publishes these weights as the newest and sends a notice.
    ///
    /// # Errors
    /// If they are larger than receivers accept, or the session is closed.
    pub async fn publish(&self, weights: Arc<Weights>) -> Result<(), BusError> {
        let bytes = encode_weights(&weights, self.epoch);
        if bytes.len() > MAX_WEIGHTS_BYTES {
            return Err(BusError::TooLarge(bytes.len()));
        }
        // Set the weights before the notice, so that no process pulls the old ones after it.
        self.latest.set(ZBytes::from(bytes));
        let notice = WeightsNotice { epoch: self.epoch, version: weights.version };
        *self.newest.lock() = Some(notice);
        self.notices.put(encode_notice(notice)).await.map_err(BusError::during("giving notice of weights"))
    }
}

/// How a pull ended.
enum Pulled {
    /// The newest weights are here, or are invalid and would be the same after a retry.
    Done,
    /// There was no reply, because the learner has no weights yet, or a router on the way does not know the learner yet
    /// or drops what exceeds its limit; or the learner refuses the pull, because too many are waiting, or it has just
    /// answered another of this process.
    Nothing,
    /// The session or the reply failed.
    Failed,
}

/// Pulls weights in the background.
struct Puller<T, K> {
    learner: Arc<Querier<'static>>,
    learner_there: Matching,
    asker: Asker,
    notices: Subscriber<RingChannelHandler<Sample>>,
    counts: Arc<Mutex<BusCounts>>,
    /// The notice that corresponds to the held weights, or to newer ones that were invalid.
    held: Option<WeightsNotice>,
    /// The newer notice that led to the next pull.
    told: Option<WeightsNotice>,
    keep: Arc<K>,
    sender: watch::Sender<Option<Arc<T>>>,
}

impl<T: Send + Sync + 'static, K: Fn(Weights) -> Option<T> + Send + Sync + 'static> Puller<T, K> {
    async fn run(mut self) {
        let mut learner_there = self.learner_there.watch();
        let mut wanted = *learner_there.borrow_and_update();
        loop {
            let mut pause = RETRY_PAUSE;
            if wanted {
                match self.pull().await {
                    Pulled::Done => wanted = false,
                    Pulled::Nothing => pause = nothing_pause(),
                    Pulled::Failed => self.counts.lock().pulls_failed_total += 1,
                }
            }
            tokio::select! {
                notice = self.notices.recv_async() => {
                    let Ok(notice) = notice else { return };
                    wanted |= self.is_newer(&notice);
                }
                changed = learner_there.changed() => {
                    // A returning learner may have published a notice while it was unreachable.
                    if changed.is_err() { return }
                    wanted = *learner_there.borrow_and_update();
                }
                () = tokio::time::sleep(pause), if wanted => {}
            }
        }
    }

    /// Returns whether the notice announces newer weights. Within an epoch, the version must grow; another epoch is
    /// another learner process and always counts as newer.
    fn is_newer(&mut self, notice: &Sample) -> bool {
        match decode_notice(&notice.payload().to_bytes()) {
            Ok(notice) => {
                let is_newer = self.held.is_none_or(|held| held.epoch != notice.epoch || held.version < notice.version);
                self.told = is_newer.then_some(notice).or(self.told);
                is_newer
            }
            Err(error) => {
                self.counts.lock().notices_invalid_total += 1;
                tracing::debug!(%error, "invalid notice of weights");
                false
            }
        }
    }

    /// Pulls the newest weights.
    async fn pull(&mut self) -> Pulled {
        let name = self.asker.turn().await;
        let Ok(replies) = self.learner.get().parameters(name).await else { return Pulled::Failed };
        let Ok(reply) = replies.recv_async().await else { return Pulled::Nothing };
        let sample = match reply.result() {
            Ok(sample) => sample,
            Err(error) if *error.encoding() == Encoding::APPLICATION_PROTOBUF.with_schema(REFUSAL_SCHEMA) => {
                return Pulled::Nothing;
            }
            Err(_) => return Pulled::Failed,
        };
        match decode_weights(sample.payload().to_bytes().into_owned().into()) {
            Ok(PublishedWeights { epoch, weights }) => {
                let pulled = Some(WeightsNotice { epoch, version: weights.version });
                if self.held != pulled {
                    self.held = pulled;
                    let keep = self.keep.clone();
                    match tokio::task::spawn_blocking(move || keep(weights)).await {
                        Ok(Some(kept)) => drop(self.sender.send_replace(Some(Arc::new(kept)))),
                        Ok(None) | Err(_) => self.counts.lock().weights_refused_total += 1,
                    }
                }
            }
            Err(error) => {
                // A retry would return the same bytes, so wait for a newer notice.
                self.held = self.told.take().or(self.held);
                self.counts.lock().weights_invalid_total += 1;
                tracing::warn!(%error, "invalid weights");
            }
        }
        Pulled::Done
    }
}

/// Returns a pause of [`NOTHING_PAUSE_MS`] that differs between processes.
fn nothing_pause() -> Duration {
    let nanos = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().subsec_nanos();
    let more_ms = u64::from(nanos) % (NOTHING_PAUSE_MS.end - NOTHING_PAUSE_MS.start);
    Duration::from_millis(NOTHING_PAUSE_MS.start + more_ms)
}

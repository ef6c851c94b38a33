//! The actor's side of trajectories: queries to the learner, and copies for viewers.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;
use zenoh::bytes::{Encoding, ZBytes};
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, Querier};

use super::matching::Matching;
use super::{Bus, BusError, SendError};
use proto::codec::{MAX_TRAJECTORY_BYTES, decode_ack, decode_refusal, encode_trajectory};
use proto::{ActorId, Trajectory, WeightsVersion, keys};

/// Encoding schema of a trajectory.
pub(super) const TRAJECTORY_SCHEMA: &str = "lodestone.v1.Trajectory";
/// Encoding schema of an acknowledgement.
pub(super) const ACK_SCHEMA: &str = "lodestone.v1.Ack";
/// Encoding schema of a refusal; it distinguishes the learner's refusals from zenoh's error replies.
pub(super) const REFUSAL_SCHEMA: &str = "lodestone.v1.Refusal";

/// Timeout for the learner's answer to a trajectory.
const ACK_TIMEOUT: Duration = Duration::from_secs(10);

/// Sends the trajectories of one actor.
///
/// The caller limits the number of trajectories in flight (2 is a good number).
#[derive(Debug)]
pub struct TrajectorySender {
    learner: Arc<Querier<'static>>,
    learner_there: Matching,
    viewers: Publisher<'static>,
    bus: Bus,
}

impl Bus {
    /// Declares the sender of an actor's trajectories.
    ///
    /// # Errors
    /// If the session is closed.
    pub async fn trajectory_sender(&self, actor: &ActorId) -> Result<TrajectorySender, BusError> {
        let failed = || BusError::during(format!("declaring the trajectories of {actor}"));
        let learner = self
            .session
            .declare_querier(keys::ingest(actor))
            .congestion_control(CongestionControl::Block)
            .priority(Priority::DataLow)
            .consolidation(ConsolidationMode::None)
            .timeout(ACK_TIMEOUT)
            .await
            .map_err(failed())?;
        let viewers = self
            .session
            .declare_publisher(keys::trajectories(actor))
            .congestion_control(CongestionControl::Drop)
            .priority(Priority::Background)
            .encoding(Encoding::APPLICATION_PROTOBUF.with_schema(TRAJECTORY_SCHEMA))
            .await
            .map_err(failed())?;
        let learner = Arc::new(learner);
        let learner_there = Matching::of(learner.clone()).await?;
        Ok(TrajectorySender { learner, learner_there, viewers, bus: self.clone() })
    }
}

impl TrajectorySender {
    /// Sends a trajectory and waits for the learner's answer, for up to 10 s: the version of its weights, once it has the
    /// trajectory.
    ///
    /// While there are viewers, every attempt also sends them a copy.
    ///
    /// # Errors
    /// If the learner does not have the trajectory, or may not have it. After [`SendError::NoReply`] the same
    /// trajectory can be sent again: the learner takes it only once.
    pub async fn send(&self, trajectory: &Trajectory) -> Result<WeightsVersion, SendError> {
        let bytes = encode_trajectory(trajectory);
        if bytes.len() > MAX_TRAJECTORY_BYTES {
            return Err(SendError::TooLarge(bytes.len()));
        }
        let payload = ZBytes::from(bytes);
        // Zenoh sends it nowhere if nobody has subscribed.
        if self.viewers.put(payload.clone()).await.is_err() {
            self.bus.counts.lock().views_failed_total += 1;
        }
        if !self.learner_there.is_matching() {
            return Err(SendError::NoLearner);
        }
        let encoding = Encoding::APPLICATION_PROTOBUF.with_schema(TRAJECTORY_SCHEMA);
        let asked = self.learner.get().payload(payload).encoding(encoding).await;
        let replies = asked.map_err(SendError::Zenoh)?;
        let Ok(reply) = replies.recv_async().await else { return Err(SendError::NoReply) };
        match reply.result() {
            Ok(sample) => Ok(decode_ack(&sample.payload().to_bytes())?),
            Err(error) if *error.encoding() == Encoding::APPLICATION_PROTOBUF.with_schema(REFUSAL_SCHEMA) => {
                Err(SendError::Refused(decode_refusal(&error.payload().to_bytes())?))
            }
            // Zenoh's error replies: a timeout, or a lost route to the learner.
            Err(_) => Err(SendError::NoReply),
        }
    }

    /// Returns whether a learner is present.
    pub fn learner_is_there(&self) -> bool {
        self.learner_there.is_matching()
    }

    /// Returns a receiver of whether a learner is present.
    pub fn watch_learner(&self) -> watch::Receiver<bool> {
        self.learner_there.watch()
    }

    /// Waits until a learner is present; returns at once if one is. Never returns after the session is closed; drop the
    /// future to cancel.
    pub async fn wait_for_learner(&self) {
        if self.watch_learner().wait_for(|&there| there).await.is_err() {
            std::future::pending::<()>().await;
        }
    }
}

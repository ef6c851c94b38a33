//! Refusals, which are sent outside of zenoh's callbacks. In a flood, most queries end without one.

use std::sync::Arc;

use parking_lot::Mutex;
use tokio::sync::mpsc;
use tokio::time::Instant;
use tokio_util::task::AbortOnDropHandle;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::query::Query;

use super::sender::REFUSAL_SCHEMA;
use super::turns::Bucket;
use proto::WeightsVersion;
use proto::codec::{Refusal, encode_refusal};

/// Maximum number of refusals that wait to be sent.
const QUEUE: usize = 256;

/// Invalid messages that are told why: at once, and per second. Each answer costs both ends and the router as much as
/// the message did.
const EXPLAINED: (u32, u32) = (64, 20);

/// Refuses queries; clones share it.
#[derive(Clone, Debug)]
pub(super) struct Refusals {
    /// With the encoded refusals.
    queue: mpsc::Sender<(Query, Vec<u8>)>,
    explained: Arc<Mutex<Bucket>>,
    _worker: Arc<AbortOnDropHandle<()>>,
}

impl Refusals {
    pub(super) fn start() -> Self {
        let (queue, mut refusals) = mpsc::channel::<(Query, Vec<u8>)>(QUEUE);
        let worker = AbortOnDropHandle::new(tokio::spawn(async move {
            while let Some((query, refusal)) = refusals.recv().await {
                let encoding = Encoding::APPLICATION_PROTOBUF.with_schema(REFUSAL_SCHEMA);
                if let Err(error) = query.reply_err(refusal).encoding(encoding).wait() {
                    tracing::debug!(key = %query.key_expr(), %error, "a refusal was not sent");
                }
            }
        }));
        let explained = Arc::new(Mutex::new(Bucket::new(EXPLAINED, Instant::now())));
        Self { queue, explained, _worker: Arc::new(worker) }
    }

    /// Refuses a query from within a callback: without a word if too many refusals are waiting. The caller counts it.
    pub(super) fn refuse(&self, query: Query, refusal: &Refusal, newest: WeightsVersion) {
        // Dropping a query ends it without a reply.
        if self.is_told(refusal) && self.queue.try_send((query, encode_refusal(refusal, newest))).is_err() {
            tracing::debug!("a query ended without a refusal, because too many are waiting");
        }
    }

    /// Refuses a query, and waits until the refusal can be sent. The caller counts it.
    pub(super) async fn refuse_in_turn(&self, query: Query, refusal: &Refusal, newest: WeightsVersion) {
        if self.is_told(refusal) && self.queue.send((query, encode_refusal(refusal, newest))).await.is_err() {
            tracing::debug!("a query ended without a refusal, because the session is closing");
        }
    }

    fn is_told(&self, refusal: &Refusal) -> bool {
        !matches!(refusal, Refusal::Invalid(_)) || self.explained.lock().take(Instant::now())
    }
}

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
use proto::codec::{Refusal, Refused, encode_refused};

/// Maximum number of refusals that wait to be sent.
const QUEUE: usize = 256;

/// Invalid messages that are told why: at once, and per second. Each answer costs both ends and the router as much as
/// the message did.
const EXPLAINED: (u32, u32) = (64, 20);

/// Refuses queries; clones share it.
#[derive(Clone, Debug)]
pub(super) struct Refusals {
    queue: mpsc::Sender<(Query, Refused)>,
    explained: Arc<Mutex<Bucket>>,
    _worker: Arc<AbortOnDropHandle<()>>,
}

impl Refusals {
    pub(super) fn start() -> Self {
        let (queue, mut refusals) = mpsc::channel::<(Query, Refused)>(QUEUE);
        let worker = AbortOnDropHandle::new(tokio::spawn(async move {
            while let Some((query, refused)) = refusals.recv().await {
                let encoding = Encoding::APPLICATION_PROTOBUF.with_schema(REFUSAL_SCHEMA);
                if let Err(error) = query.reply_err(encode_refused(&refused)).encoding(encoding).wait() {
                    tracing::debug!(key = %query.key_expr(), %error, "a refusal was not sent");
                }
            }
        }));
        let explained = Arc::new(Mutex::new(Bucket::new(EXPLAINED, Instant::now())));
        Self { queue, explained, _worker: Arc::new(worker) }
    }

    /// Refuses a query from within a callback: without a word if too many refusals are waiting. The caller counts it.
    pub(super) fn refuse(&self, query: Query, refused: Refused) {
        // Dropping a query ends it without a reply.
        if self.is_told(&refused) && self.queue.try_send((query, refused)).is_err() {
            tracing::debug!("a query ended without a refusal, because too many are waiting");
        }
    }

    /// Refuses a query, and waits until the refusal can be sent. The caller counts it.
    pub(super) async fn refuse_in_turn(&self, query: Query, refused: Refused) {
        if self.is_told(&refused) && self.queue.send((query, refused)).await.is_err() {
            tracing::debug!("a query ended without a refusal, because the session is closing");
        }
    }

    fn is_told(&self, refused: &Refused) -> bool {
        !matches!(refused.refusal, Refusal::Invalid(_)) || self.explained.lock().take(Instant::now())
    }
}

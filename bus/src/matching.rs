//! Whether a key has a matching subscriber or queryable.

use std::sync::Arc;

use tokio::sync::watch;
use zenoh::handlers::RingChannel;
use zenoh::pubsub::Publisher;
use zenoh::query::Querier;

use super::BusError;
use tokio_util::task::AbortOnDropHandle;

/// Follows the matching status of a querier or publisher.
#[derive(Debug)]
pub(super) struct Matching {
    status: watch::Receiver<bool>,
    _task: AbortOnDropHandle<()>,
}

/// Defines the same task for the two zenoh types that have a matching status but no common trait.
macro_rules! follow {
    ($name:ident, $type:ty) => {
        pub(super) async fn $name(entity: Arc<$type>) -> Result<Self, BusError> {
            let failed = || BusError::during(format!("watching who is at {}", entity.key_expr()));
            // A notification only means that the status changed. Read it again, so that a late notification cannot
            // overwrite a newer status.
            let changes = entity.matching_listener().with(RingChannel::new(1)).await.map_err(failed())?;
            let now = entity.matching_status().await.map_err(failed())?.matching();
            let (sender, status) = watch::channel(now);
            let task = AbortOnDropHandle::new(tokio::spawn(async move {
                while changes.recv_async().await.is_ok() {
                    let Ok(now) = entity.matching_status().await else { return };
                    sender.send_replace(now.matching());
                }
            }));
            Ok(Self { status, _task: task })
        }
    };
}

impl Matching {
    follow!(of_querier, Querier<'static>);
    follow!(of_publisher, Publisher<'static>);

    pub(super) fn is_matching(&self) -> bool {
        *self.status.borrow()
    }

    pub(super) fn watch(&self) -> watch::Receiver<bool> {
        self.status.clone()
    }
}

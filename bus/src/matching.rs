//! Whether a key has a matching queryable.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{mpsc, watch};
use zenoh::Wait;
use zenoh::query::Querier;

use super::BusError;
use tokio_util::task::AbortOnDropHandle;

/// Interval between looks at the status without a notification. zenoh compares the status with what the notification
/// says and drops the notification if they differ; under load the status may follow a moment later.
const LOOK_PERIOD: Duration = Duration::from_secs(2);

/// Follows the matching status of a querier.
#[derive(Debug)]
pub(super) struct Matching {
    status: watch::Receiver<bool>,
    _task: AbortOnDropHandle<()>,
}

impl Matching {
    pub(super) async fn of(querier: Arc<Querier<'static>>) -> Result<Self, BusError> {
        let failed = || BusError::during(format!("watching who is at {}", querier.key_expr()));
        let (notifier, changes) = mpsc::channel(1);
        let notify = move |_| {
            // One that waits stands for both.
            let _ = notifier.try_send(());
        };
        querier.matching_listener().callback(notify).background().await.map_err(failed())?;
        let now = querier.matching_status().await.map_err(failed())?.matching();
        let (sender, status) = watch::channel(now);
        let task = AbortOnDropHandle::new(tokio::spawn(async move {
            follow(sender, changes, || Some(querier.matching_status().wait().ok()?.matching())).await;
        }));
        Ok(Self { status, _task: task })
    }

    pub(super) fn is_matching(&self) -> bool {
        *self.status.borrow()
    }

    pub(super) fn watch(&self) -> watch::Receiver<bool> {
        self.status.clone()
    }
}

/// Sends the status after each notification, and when it differs without one, until there are no more of either.
async fn follow(sender: watch::Sender<bool>, mut changes: mpsc::Receiver<()>, status: impl Fn() -> Option<bool>) {
    loop {
        let notified = tokio::time::timeout(LOOK_PERIOD, changes.recv()).await;
        // A notification only means that the status changed. Read it again, so that a late notification cannot overwrite
        // a newer status.
        let Some(now) = status() else { return };
        match notified {
            Ok(None) => return,
            Err(_) if *sender.borrow() == now => {}
            Ok(Some(())) | Err(_) => drop(sender.send_replace(now)),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};

    use super::*;

    #[tokio::test]
    async fn a_change_without_a_notification_is_seen() {
        let is_there = Arc::new(AtomicBool::new(false));
        let (sender, mut status) = watch::channel(false);
        let (_notifier, changes) = mpsc::channel(1);
        let there = is_there.clone();
        let _task = AbortOnDropHandle::new(tokio::spawn(async move {
            follow(sender, changes, || Some(there.load(Ordering::Relaxed))).await;
        }));
        is_there.store(true, Ordering::Relaxed);
        status.changed().await.unwrap();
        assert!(*status.borrow());
    }
}

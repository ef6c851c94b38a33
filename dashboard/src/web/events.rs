//! Server-sent events to browsers, through bounded queues.

use std::convert::Infallible;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::Bytes;
use hyper::body::{Body, Frame};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio_util::sync::CancellationToken;

/// Capacity of a browser's event queue. An evaluation of the whole catalog is a burst of 167.
const QUEUE: usize = 1024;

/// Maximum number of browsers listening at a time, to all runs of the page together.
pub(super) const MAX_VIEWERS: usize = 32;

/// How long a page that ends waits for browsers to fetch what came last. A test on a busy machine may take its time.
const LAST_WAIT: Duration = Duration::from_secs(if cfg!(test) { 60 } else { 3 });

/// The places for listening browsers, which all runs of a page share.
#[derive(Clone, Debug)]
pub(super) struct Places(Arc<Semaphore>);

impl Default for Places {
    fn default() -> Self {
        Self(Arc::new(Semaphore::new(MAX_VIEWERS)))
    }
}

impl Places {
    /// Takes a place, if one is free.
    pub(super) fn take(&self) -> Option<OwnedSemaphorePermit> {
        self.0.clone().try_acquire_owned().ok()
    }

    /// Waits until no browser listens, but not for longer than [`LAST_WAIT`].
    pub(super) async fn left(&self) {
        // Late browsers are only a reason to stop waiting.
        let _ = tokio::time::timeout(LAST_WAIT, self.0.acquire_many(MAX_VIEWERS as u32)).await;
    }
}

/// All listening browsers.
#[derive(Debug, Default)]
pub(super) struct Viewers(Vec<Viewer>);

#[derive(Debug)]
struct Viewer {
    queue: mpsc::Sender<Bytes>,
    close: CancellationToken,
}

/// The stream of events to one browser.
#[derive(Debug)]
pub(super) struct Events {
    first: Option<Bytes>,
    queue: mpsc::Receiver<Bytes>,
    _place: OwnedSemaphorePermit,
}

/// Formats an event. JSON contains no line breaks, so `data` is one line.
pub(super) fn event(name: &'static str, data: &serde_json::Value) -> Bytes {
    format!("event: {name}\ndata: {data}\n\n").into()
}

impl Viewers {
    /// Adds a listener, which keeps its `place` and receives `first` before everything else.
    pub(super) fn add(&mut self, first: Bytes, close: CancellationToken, place: OwnedSemaphorePermit) -> Events {
        self.0.retain(|viewer| !viewer.queue.is_closed());
        let (sender, queue) = mpsc::channel(QUEUE);
        self.0.push(Viewer { queue: sender, close });
        Events { first: Some(first), queue, _place: place }
    }

    /// Sends to all listeners. Closes the connections of those with a full queue and returns their number.
    pub(super) fn send(&mut self, text: &Bytes) -> u64 {
        let mut n_dropped = 0;
        self.0.retain(|viewer| match viewer.queue.try_send(text.clone()) {
            Ok(()) => true,
            Err(mpsc::error::TrySendError::Closed(_)) => false,
            Err(mpsc::error::TrySendError::Full(_)) => {
                // Closing the queue is not enough: a blocked connection would not notice.
                viewer.close.cancel();
                n_dropped += 1;
                false
            }
        });
        n_dropped
    }

    /// Returns the number of listeners.
    pub(super) fn len(&self) -> usize {
        self.0.len()
    }
}

impl Body for Events {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        let next = match self.first.take() {
            Some(first) => Poll::Ready(Some(first)),
            None => self.queue.poll_recv(context),
        };
        next.map(|text| text.map(|text| Ok(Frame::data(text))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_does_not_listen_is_dropped_and_the_others_are_not() {
        let mut viewers = Viewers::default();
        let places = Places::default();
        let place = || places.take().unwrap();
        let (closed, other_closed) = (CancellationToken::new(), CancellationToken::new());
        let _slow = viewers.add(Bytes::new(), closed.clone(), place());
        let text = event("metrics", &serde_json::json!({ "key": "a\nb" }));
        assert_eq!(text, "event: metrics\ndata: {\"key\":\"a\\nb\"}\n\n");
        for _ in 0..QUEUE {
            assert_eq!(viewers.send(&text), 0);
        }
        let _quick = viewers.add(Bytes::new(), other_closed.clone(), place());
        assert_eq!((viewers.send(&text), viewers.len()), (1, 1));
        assert!(closed.is_cancelled() && !other_closed.is_cancelled());
    }

    #[test]
    fn a_listener_that_is_gone_leaves_its_place() {
        let mut viewers = Viewers::default();
        let places = Places::default();
        let all: Vec<_> = std::iter::from_fn(|| places.take()).collect();
        assert_eq!(all.len(), MAX_VIEWERS);
        let listen = |place| viewers.add(Bytes::new(), CancellationToken::new(), place);
        let mut listeners: Vec<Events> = all.into_iter().map(listen).collect();
        listeners.pop();
        let last = places.take();
        assert!(last.is_some() && places.take().is_none());
        drop((listeners, last));
        assert_eq!(places.0.available_permits(), MAX_VIEWERS);
    }
}

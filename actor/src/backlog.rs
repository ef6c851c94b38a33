//! The bounded queue between stepping threads and sending tasks.

use parking_lot::{Condvar, Mutex, MutexGuard};
use std::collections::VecDeque;

use proto::Trajectory;
use tokio::sync::Notify;

use crate::FullBacklog;

/// Segments waiting to be sent, oldest first.
#[derive(Debug)]
pub(crate) struct Backlog {
    limit: usize,
    when_full: FullBacklog,
    state: Mutex<State>,
    /// Wakes a sender when there is a segment or the backlog is closed.
    filled: Notify,
    /// Wakes stepping threads when there is room or the backlog is closed.
    emptied: Condvar,
}

#[derive(Debug, Default)]
struct State {
    segments: VecDeque<Trajectory>,
    next_seq: u64,
    closed: bool,
}

impl Backlog {
    /// Creates an empty backlog for `limit` segments, at least 1.
    pub(crate) fn new(limit: usize, when_full: FullBacklog) -> Self {
        Self { limit: limit.max(1), when_full, state: Mutex::default(), filled: Notify::new(), emptied: Condvar::new() }
    }

    /// Numbers the newest segment and adds it.
    ///
    /// All threads share the numbers, which follow the order of the queue: the learner remembers only the newest numbers
    /// of an actor and would take those of a slower thread for old ones.
    ///
    /// If the backlog is full, this drops the oldest segment, or blocks the thread until there is room or the backlog
    /// is closed. Returns how many segments were dropped.
    pub(crate) fn push(&self, mut segment: Trajectory) -> u64 {
        let mut state = self.state.lock();
        while self.when_full == FullBacklog::Pause && !state.closed && state.segments.len() >= self.limit {
            self.emptied.wait(&mut state);
        }
        segment.seq = state.next_seq;
        state.next_seq += 1;
        state.segments.push_back(segment);
        self.shed(state)
    }

    /// Puts back a segment that could not be sent. It is the oldest again, and the first to be dropped if there is no
    /// room.
    ///
    /// A pausing backlog drops nothing and exceeds its limit by the segments that senders had taken. Returns how many
    /// segments were dropped.
    pub(crate) fn put_back(&self, segment: Trajectory) -> u64 {
        let mut state = self.state.lock();
        state.segments.push_front(segment);
        self.shed(state)
    }

    /// Removes and returns the oldest segment, waiting for one; `None` once the backlog is closed and empty.
    pub(crate) async fn pop(&self) -> Option<Trajectory> {
        loop {
            {
                let mut state = self.state.lock();
                let segment = state.segments.pop_front();
                if segment.is_some() || state.closed {
                    let more = !state.segments.is_empty() || state.closed;
                    drop(state);
                    self.emptied.notify_one();
                    if more {
                        // Only one permit is stored however many segments arrive, so each receiver wakes the next.
                        self.filled.notify_one();
                    }
                    return segment;
                }
            }
            self.filled.notified().await;
        }
    }

    /// Closes the backlog: receivers get the remaining segments and then `None`.
    pub(crate) fn close(&self) {
        self.state.lock().closed = true;
        self.filled.notify_one();
        self.emptied.notify_all();
    }

    /// Drops all waiting segments and returns their number.
    pub(crate) fn clear(&self) -> u64 {
        let segments = std::mem::take(&mut self.state.lock().segments);
        self.emptied.notify_all();
        segments.len() as u64
    }

    /// Drops the oldest segments beyond the limit, unless the backlog pauses, and wakes a sender. Returns how many
    /// segments were dropped.
    fn shed(&self, mut state: MutexGuard<'_, State>) -> u64 {
        let n_dropped = match self.when_full {
            FullBacklog::Pause => 0,
            FullBacklog::DropOldest => state.segments.len().saturating_sub(self.limit),
        };
        state.segments.drain(..n_dropped);
        drop(state);
        self.filled.notify_one();
        n_dropped as u64
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::tests::toy::trajectory;

    async fn drain(backlog: &Backlog) -> Vec<u64> {
        backlog.close();
        let mut seqs = Vec::new();
        while let Some(segment) = backlog.pop().await {
            seqs.push(segment.seq);
        }
        seqs
    }

    #[tokio::test]
    async fn the_newest_segments_are_kept_and_the_others_counted() {
        let backlog = Backlog::new(3, FullBacklog::DropOldest);
        let n_dropped: u64 = (0..5).map(|_| backlog.push(trajectory())).sum();
        assert_eq!((n_dropped, backlog.state.lock().segments.len()), (2, 3));
        // A segment that is put back is the oldest, so it is dropped if its place was taken in the meantime.
        let taken = backlog.pop().await.unwrap();
        assert_eq!((taken.seq, backlog.push(trajectory())), (2, 0));
        assert_eq!(backlog.put_back(taken), 1);
        assert_eq!(drain(&backlog).await, [3, 4, 5]);
    }

    #[tokio::test]
    async fn a_segment_that_comes_back_is_sent_first() {
        let backlog = Backlog::new(3, FullBacklog::DropOldest);
        (0..3).for_each(|_| assert_eq!(backlog.push(trajectory()), 0));
        let taken = backlog.pop().await.unwrap();
        assert_eq!(backlog.put_back(taken), 0);
        assert_eq!(drain(&backlog).await, [0, 1, 2]);
    }

    #[tokio::test]
    async fn a_pausing_backlog_drops_nothing() {
        let backlog = Arc::new(Backlog::new(2, FullBacklog::Pause));
        let pushing = backlog.clone();
        let thread = tokio::task::spawn_blocking(move || (0..20).map(|_| pushing.push(trajectory())).sum::<u64>());
        let mut seqs = Vec::new();
        while seqs.len() < 20 {
            seqs.push(backlog.pop().await.unwrap().seq);
        }
        assert_eq!(thread.await.unwrap(), 0);
        assert_eq!(seqs, (0..20).collect::<Vec<_>>());
    }

    #[tokio::test]
    async fn numbers_follow_the_order_of_the_queue_across_threads() {
        let backlog = Backlog::new(400, FullBacklog::Pause);
        std::thread::scope(|scope| {
            for n_segments in [100, 300] {
                let backlog = &backlog;
                scope.spawn(move || (0..n_segments).for_each(|_| assert_eq!(backlog.push(trajectory()), 0)));
            }
        });
        assert_eq!(drain(&backlog).await, (0..400).collect::<Vec<_>>());
    }

    #[tokio::test]
    async fn closing_wakes_a_paused_thread() {
        let backlog = Arc::new(Backlog::new(1, FullBacklog::Pause));
        backlog.push(trajectory());
        let pushing = backlog.clone();
        let thread = tokio::task::spawn_blocking(move || pushing.push(trajectory()));
        backlog.close();
        thread.await.unwrap();
        assert_eq!(drain(&backlog).await, [0, 1]);
    }
}

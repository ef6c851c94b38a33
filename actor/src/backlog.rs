//! The bounded queue between stepping threads and sending tasks.

use parking_lot::{Condvar, Mutex, MutexGuard};
use std::collections::VecDeque;

use proto::Trajectory;
use tokio::sync::Notify;

use crate::FullBacklog;

/// Segments waiting to be sent, oldest first.
#[derive(Debug)]
pub struct Backlog {
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
    /// Number of the next segment.
    next_seq: u64,
    closed: bool,
}

impl Backlog {
    /// Creates an empty backlog for `limit` segments, at least 1.
    pub fn new(limit: usize, when_full: FullBacklog) -> Self {
        Self { limit: limit.max(1), when_full, state: Mutex::default(), filled: Notify::new(), emptied: Condvar::new() }
    }

    /// Numbers the newest segment and adds it.
    ///
    /// All threads share the numbers, which follow the order of the queue: the learner remembers only the newest numbers
    /// of an actor and would take those of a slower thread for old ones.
    ///
    /// If the backlog is full, this drops the oldest segment, or blocks the thread until there is room or the backlog
    /// is closed. Returns how many segments were dropped.
    pub fn push(&self, mut segment: Trajectory) -> u64 {
        let mut state = self.lock();
        while self.when_full == FullBacklog::Pause && !state.closed && state.segments.len() >= self.limit {
            self.emptied.wait(&mut state);
        }
        segment.seq = state.next_seq;
        state.next_seq += 1;
        state.segments.push_back(segment);
        let n_dropped = self.shed(&mut state);
        drop(state);
        self.filled.notify_one();
        n_dropped
    }

    /// Puts back a segment that could not be sent. It is the oldest again, and the first to be dropped if there is no
    /// room.
    ///
    /// A pausing backlog drops nothing and exceeds its limit by the segments that senders had taken. Returns how many
    /// segments were dropped.
    pub fn put_back(&self, segment: Trajectory) -> u64 {
        let mut state = self.lock();
        state.segments.push_front(segment);
        let n_dropped = self.shed(&mut state);
        drop(state);
        self.filled.notify_one();
        n_dropped
    }

    /// Removes and returns the oldest segment, waiting for one; `None` once the backlog is closed and empty.
    pub async fn pop(&self) -> Option<Trajectory> {
        loop {
            {
                let mut state = self.lock();
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
    pub fn close(&self) {
        self.lock().closed = true;
        self.filled.notify_one();
        self.emptied.notify_all();
    }

    /// Returns whether [`Backlog::close`] was called.
    pub fn is_closed(&self) -> bool {
        self.lock().closed
    }

    /// Returns the number of waiting segments.
    pub fn len(&self) -> usize {
        self.lock().segments.len()
    }

    /// Returns whether no segments are waiting.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Drops all waiting segments and returns their number.
    pub fn clear(&self) -> u64 {
        let segments = std::mem::take(&mut self.lock().segments);
        self.emptied.notify_all();
        segments.len() as u64
    }

    fn shed(&self, state: &mut State) -> u64 {
        if self.when_full == FullBacklog::Pause {
            return 0;
        }
        let n_too_many = state.segments.len().saturating_sub(self.limit);
        state.segments.drain(..n_too_many);
        n_too_many as u64
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // Every statement leaves the state consistent, so a panic elsewhere does no harm.
        self.state.lock()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use proto::{Status, WeightsVersion};

    use super::*;
    use crate::segment::{Cut, SegmentBuilder};
    use crate::toy;

    fn segment() -> Trajectory {
        let mut rollout = SegmentBuilder::new(1, toy::task());
        let transition = proto::Transition {
            scene: toy::scene(),
            action: proto::Action { choices: [None; 2], moves: [[0.0; 6]; 16] },
            proposals: [None; 2],
            behavior_log_prob: 0.0,
            reward: Default::default(),
            disturbance: None,
        };
        let cut = rollout.push(transition, WeightsVersion(0), &toy::scene(), Status::Running, &toy::identity());
        let Cut::Segment(segment) = cut else { panic!("a segment of one step is complete") };
        *segment
    }

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
        let n_dropped: u64 = (0..5).map(|_| backlog.push(segment())).sum();
        assert_eq!((n_dropped, backlog.len()), (2, 3));
        // A segment that is put back is the oldest, so it is dropped if its place was taken in the meantime.
        let taken = backlog.pop().await.unwrap();
        assert_eq!((taken.seq, backlog.push(segment())), (2, 0));
        assert_eq!(backlog.put_back(taken), 1);
        assert_eq!(drain(&backlog).await, [3, 4, 5]);
    }

    #[tokio::test]
    async fn a_segment_that_comes_back_is_sent_first() {
        let backlog = Backlog::new(3, FullBacklog::DropOldest);
        (0..3).for_each(|_| assert_eq!(backlog.push(segment()), 0));
        let taken = backlog.pop().await.unwrap();
        assert_eq!(backlog.put_back(taken), 0);
        assert_eq!(drain(&backlog).await, [0, 1, 2]);
    }

    #[tokio::test]
    async fn a_pausing_backlog_drops_nothing() {
        let backlog = Arc::new(Backlog::new(2, FullBacklog::Pause));
        let pushing = backlog.clone();
        let thread = tokio::task::spawn_blocking(move || (0..20).map(|_| pushing.push(segment())).sum::<u64>());
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
                scope.spawn(move || (0..n_segments).for_each(|_| assert_eq!(backlog.push(segment()), 0)));
            }
        });
        assert_eq!(drain(&backlog).await, (0..400).collect::<Vec<_>>());
    }

    #[tokio::test]
    async fn closing_wakes_a_paused_thread() {
        let backlog = Arc::new(Backlog::new(1, FullBacklog::Pause));
        backlog.push(segment());
        let pushing = backlog.clone();
        let thread = tokio::task::spawn_blocking(move || pushing.push(segment()));
        backlog.close();
        thread.await.unwrap();
        assert_eq!(drain(&backlog).await, [0, 1]);
    }
}

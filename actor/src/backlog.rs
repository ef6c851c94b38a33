//! The bounded queue between the threads that step and the tasks that send.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use proto::Trajectory;
use tokio::sync::Notify;

use crate::FullBacklog;

/// Segments that wait to be sent, oldest first.
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
    closed: bool,
}

impl Backlog {
    /// An empty backlog for `limit` segments, at least 1.
    pub fn new(limit: usize, when_full: FullBacklog) -> Self {
        Self { limit: limit.max(1), when_full, state: Mutex::default(), filled: Notify::new(), emptied: Condvar::new() }
    }

    /// Adds the newest segment.
    ///
    /// When it is full, this drops the oldest, or blocks the thread until there is room or it is closed. Returns how many
    /// segments were dropped.
    pub fn push(&self, segment: Trajectory) -> u64 {
        let mut state = self.lock();
        while self.when_full == FullBacklog::Pause && !state.closed && state.segments.len() >= self.limit {
            state = self.emptied.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        state.segments.push_back(segment);
        let n_dropped = self.shed(&mut state);
        drop(state);
        self.filled.notify_one();
        n_dropped
    }

    /// Puts a segment back that could not be sent; it is the oldest again and the first to go when there is no room.
    ///
    /// A pausing backlog drops nothing and exceeds its limit by what the senders had taken. Returns how many were dropped.
    pub fn put_back(&self, segment: Trajectory) -> u64 {
        let mut state = self.lock();
        state.segments.push_front(segment);
        let n_dropped = self.shed(&mut state);
        drop(state);
        self.filled.notify_one();
        n_dropped
    }

    /// Takes the oldest segment, waiting for one; `None` when the backlog is closed and empty.
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
                        // One permit is stored however many segments came, so each taker wakes the next.
                        self.filled.notify_one();
                    }
                    return segment;
                }
            }
            self.filled.notified().await;
        }
    }

    /// No segment will come any more: takers get what is left and then `None`.
    pub fn close(&self) {
        self.lock().closed = true;
        self.filled.notify_one();
        self.emptied.notify_all();
    }

    /// Whether [`Backlog::close`] was called.
    pub fn is_closed(&self) -> bool {
        self.lock().closed
    }

    /// Number of waiting segments.
    pub fn len(&self) -> usize {
        self.lock().segments.len()
    }

    /// Whether nothing waits.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Drops everything that waits and returns how many segments that was.
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
        // The state is consistent after every statement, so a panic elsewhere does not spoil it.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

//! The queue of recorded episodes to be rendered. When it is full, new episodes are counted and dropped.

use parking_lot::{Condvar, Mutex};
use std::collections::VecDeque;

use proto::Trajectory;
use proto::metrics::VideoCounts;

/// Queue capacity: three evaluations of the default videos, each up to about a megabyte.
pub(super) const ROOM: usize = 32;

/// A bounded queue of recorded episodes.
#[derive(Debug, Default)]
pub(super) struct ClipQueue {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    episodes: VecDeque<Trajectory>,
    is_closed: bool,
    /// All counts except `n_waiting`.
    counts: VideoCounts,
}

impl ClipQueue {
    /// Adds an episode to the queue. If the queue is full or closed, drops and counts it instead.
    pub(super) fn offer(&self, episode: Trajectory) {
        let mut state = self.state.lock();
        if state.is_closed || state.episodes.len() >= ROOM {
            state.counts.dropped_total += 1;
            tracing::debug!(blueprint = %episode.task.blueprint, "no room for a video");
            return;
        }
        state.episodes.push_back(episode);
        self.changed.notify_all();
    }

    pub(super) fn counts(&self) -> VideoCounts {
        self.state.lock().all_counts()
    }

    /// Waits for the next episode and returns it, and whether the queue is closed; `None` once it is also empty.
    pub(super) fn next(&self) -> Option<(Trajectory, bool)> {
        let is_idle = |state: &mut State| state.episodes.is_empty() && !state.is_closed;
        let mut state = self.state.lock();
        self.changed.wait_while(&mut state, is_idle);
        let episode = state.episodes.pop_front()?;
        Some((episode, state.is_closed))
    }

    pub(super) fn count(&self, change: impl FnOnce(&mut VideoCounts)) {
        change(&mut self.state.lock().counts);
        self.changed.notify_all();
    }

    pub(super) fn close(&self) {
        self.state.lock().is_closed = true;
        self.changed.notify_all();
    }

    #[cfg(test)]
    pub(super) fn wait_until(&self, is_reached: impl Fn(VideoCounts) -> bool) -> VideoCounts {
        let waits = |state: &mut State| !is_reached(state.all_counts());
        let mut state = self.state.lock();
        self.changed.wait_while(&mut state, waits);
        state.all_counts()
    }
}

impl State {
    fn all_counts(&self) -> VideoCounts {
        VideoCounts { n_waiting: self.episodes.len() as u64, ..self.counts }
    }
}

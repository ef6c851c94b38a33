//! The queue of recorded episodes to be rendered. When it is full, new episodes are counted and dropped.

use parking_lot::{Condvar, Mutex, MutexGuard};
use std::collections::VecDeque;

use proto::Trajectory;
use proto::metrics::FilmCounts;
use runlog::clips::Ending;

/// Queue capacity: three evaluations of the default films, each up to about a megabyte.
pub(super) const ROOM: usize = 32;

/// A recorded episode to be rendered.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Clip {
    pub(super) trajectory: Trajectory,
    pub(super) n_env_steps: u64,
    pub(super) ending: Ending,
    /// Number among the evaluation's clips of the same blueprint and ending, from 1.
    pub(super) number: u32,
    /// TensorBoard tags.
    pub(super) tags: Vec<String>,
}

/// A bounded queue of clips to be rendered.
#[derive(Debug, Default)]
pub(super) struct ClipQueue {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    clips: VecDeque<Clip>,
    is_closed: bool,
    /// All counts except `n_waiting`.
    counts: FilmCounts,
}

/// Result of processing a clip.
pub(super) enum Made {
    Film { is_oversized: bool },
    RecordingOnly,
}

impl ClipQueue {
    /// Adds a clip to the queue. If the queue is full or closed, drops and counts it instead.
    pub(super) fn offer(&self, clip: Clip) {
        let mut state = self.state();
        if state.is_closed || state.clips.len() >= ROOM {
            state.counts.dropped_total += 1;
            tracing::debug!(blueprint = %clip.trajectory.task.blueprint, "no room for a film");
            return;
        }
        state.clips.push_back(clip);
        self.changed.notify_all();
    }

    pub(super) fn count_unrecorded(&self) {
        self.state().counts.unrecorded_total += 1;
    }

    pub(super) fn counts(&self) -> FilmCounts {
        self.state().all_counts()
    }

    /// Waits for the next clip and returns it; `None` once the queue is closed and empty.
    pub(super) fn next(&self) -> Option<Clip> {
        let is_idle = |state: &mut State| state.clips.is_empty() && !state.is_closed;
        let mut state = self.state();
        self.changed.wait_while(&mut state, is_idle);
        state.clips.pop_front()
    }

    pub(super) fn is_closed(&self) -> bool {
        self.state().is_closed
    }

    pub(super) fn note(&self, made: anyhow::Result<Made>, clip: &Clip) {
        let mut state = self.state();
        let counts = &mut state.counts;
        match made {
            Ok(Made::Film { is_oversized }) => {
                counts.written_total += 1;
                counts.oversized_total += u64::from(is_oversized);
            }
            Ok(Made::RecordingOnly) => counts.dropped_total += 1,
            Err(error) => {
                counts.failed_total += 1;
                tracing::warn!(blueprint = %clip.trajectory.task.blueprint, "a film failed: {error:#}");
            }
        }
        self.changed.notify_all();
    }

    pub(super) fn close(&self) {
        self.state().is_closed = true;
        self.changed.notify_all();
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock()
    }

    #[cfg(test)]
    pub(super) fn wait_until(&self, is_reached: impl Fn(FilmCounts) -> bool) -> FilmCounts {
        let waits = |state: &mut State| !is_reached(state.all_counts());
        let mut state = self.state();
        self.changed.wait_while(&mut state, waits);
        state.all_counts()
    }
}

impl State {
    fn all_counts(&self) -> FilmCounts {
        FilmCounts { n_waiting: self.clips.len() as u64, ..self.counts }
    }
}

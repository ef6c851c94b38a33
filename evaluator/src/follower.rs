//! What follows an evaluation: callbacks, one of which can interrupt it, and a count of endings.

use environment::Step;
use proto::{ActionMode, Observation, Scene};

use crate::endings::{EndingRecord, Endings};
use crate::report::EpisodeResult;
use crate::sequences::{EpisodeObserver, EpisodeSpec};

/// What follows an evaluation. Both callbacks are called by the threads that run episodes.
pub struct Follower<'a> {
    /// Called at every step; returning false interrupts the evaluation.
    pub keep_going: &'a (dyn Fn() -> bool + Sync),
    /// Called with the result of each episode when it ends, except in reset-free runs.
    pub on_episode: &'a (dyn Fn(&EpisodeResult) + Sync),
    /// Counts how the episodes end, except in reset-free runs.
    pub endings: Option<&'a Endings>,
}

impl Default for Follower<'_> {
    /// Never interrupts, and ignores the results.
    fn default() -> Self {
        Self { keep_going: &|| true, on_episode: &|_| {}, endings: None }
    }
}

impl EpisodeObserver for Follower<'_> {
    type Record = Option<EndingRecord>;

    fn begin(&self, _: usize, _: &EpisodeSpec, _: ActionMode, start: Observation<'_>) -> Option<Self::Record> {
        Some(self.endings.map(|_| EndingRecord::new(start)))
    }

    fn observe(&self, record: &mut Self::Record, step: Step, after: Observation<'_>) {
        if let Some(record) = record {
            record.note(&step, after);
        }
    }

    fn end(&self, record: Self::Record, _: &EpisodeSpec, _: &Scene, result: &EpisodeResult) {
        if let (Some(endings), Some(record)) = (self.endings, record) {
            endings.count(record, result);
        }
        (self.on_episode)(result);
    }
}

//! Callbacks that follow an evaluation and can interrupt it.

use environment::Step;
use proto::{ActionMode, Observation, Scene};

use crate::report::EpisodeResult;
use crate::sequences::{EpisodeObserver, EpisodeSpec, Place};

/// Callbacks of an evaluation. Both are called by the threads that run episodes.
pub struct Follower<'a> {
    /// Called at every step; returning false interrupts the evaluation.
    pub keep_going: &'a (dyn Fn() -> bool + Sync),
    /// Called with the result of each episode when it ends, except in reset-free runs.
    pub on_episode: &'a (dyn Fn(&EpisodeResult) + Sync),
}

impl Default for Follower<'_> {
    /// Never interrupts, and ignores the results.
    fn default() -> Self {
        Self { keep_going: &|| true, on_episode: &|_| {} }
    }
}

impl EpisodeObserver for Follower<'_> {
    type Record = ();

    fn begin(&self, _: Place, _: &EpisodeSpec, _: ActionMode, _: Observation<'_>) -> Option<()> {
        Some(())
    }

    fn observe(&self, (): &mut (), _: Step, _: Observation<'_>) {}

    fn end(&self, (): (), _: &EpisodeSpec, _: &Scene, result: &EpisodeResult) {
        (self.on_episode)(result);
    }
}

/// Forwards episodes to two observers.
pub(crate) struct Both<'a, X, Y>(pub(crate) &'a X, pub(crate) &'a Y);

impl<X: EpisodeObserver, Y: EpisodeObserver> EpisodeObserver for Both<'_, X, Y> {
    type Record = (Option<X::Record>, Option<Y::Record>);

    fn begin(
        &self,
        place: Place,
        spec: &EpisodeSpec,
        acting: ActionMode,
        start: Observation<'_>,
    ) -> Option<Self::Record> {
        Some((self.0.begin(place, spec, acting, start), self.1.begin(place, spec, acting, start)))
    }

    fn observe(&self, (x, y): &mut Self::Record, step: Step, after: Observation<'_>) {
        if let Some(x) = x {
            self.0.observe(x, step.clone(), after);
        }
        if let Some(y) = y {
            self.1.observe(y, step, after);
        }
    }

    fn end(&self, (x, y): Self::Record, spec: &EpisodeSpec, last: &Scene, result: &EpisodeResult) {
        if let Some(x) = x {
            self.0.end(x, spec, last, result);
        }
        if let Some(y) = y {
            self.1.end(y, spec, last, result);
        }
    }
}

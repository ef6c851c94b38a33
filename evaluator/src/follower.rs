//! Callbacks that follow an evaluation and can interrupt it.

use environment::Step;
use parking_lot::Mutex;
use proto::{ActionMode, Agent, Observation, Scene};

use crate::report::EpisodeResult;
use crate::sequences::{EpisodeObserver, EpisodeSpec, Place};

/// Callbacks of an evaluation. Both are called by the threads that run episodes.
pub struct Follower<'a> {
    /// Called at every step; returning false interrupts the evaluation.
    pub keep_going: &'a (dyn Fn() -> bool + Sync),
    /// Called with the result of each episode when it ends, except in reset-free runs.
    pub on_episode: &'a (dyn Fn(&EpisodeResult) + Sync),
}

impl<A: Agent> EpisodeObserver<A> for Follower<'_> {
    type Record = ();

    fn begin(&self, _: Place, _: &EpisodeSpec, _: ActionMode, _: Observation<'_>) -> Option<()> {
        Some(())
    }

    fn observe(&self, (): &mut (), _: Step, _: &A, _: usize, _: Observation<'_>) {}

    fn end(&self, (): (), _: &EpisodeSpec, _: &Scene, result: &EpisodeResult) {
        (self.on_episode)(result);
    }
}

/// Collects episode results in the order in which the episodes end.
#[derive(Default)]
pub(crate) struct Tally {
    episodes: Mutex<Vec<EpisodeResult>>,
}

impl Tally {
    /// Returns all collected results.
    pub(crate) fn into_episodes(self) -> Vec<EpisodeResult> {
        self.episodes.into_inner()
    }
}

impl<A: Agent> EpisodeObserver<A> for Tally {
    type Record = ();

    fn begin(&self, _: Place, _: &EpisodeSpec, _: ActionMode, _: Observation<'_>) -> Option<()> {
        Some(())
    }

    fn observe(&self, (): &mut (), _: Step, _: &A, _: usize, _: Observation<'_>) {}

    fn end(&self, (): (), _: &EpisodeSpec, _: &Scene, result: &EpisodeResult) {
        self.episodes.lock().push(result.clone());
    }
}

/// Forwards episodes to two observers.
pub(crate) struct Both<'a, X, Y>(pub(crate) &'a X, pub(crate) &'a Y);

impl<A: Agent, X: EpisodeObserver<A>, Y: EpisodeObserver<A>> EpisodeObserver<A> for Both<'_, X, Y> {
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

    fn observe(&self, (x, y): &mut Self::Record, step: Step, agent: &A, row: usize, after: Observation<'_>) {
        if let Some(x) = x {
            self.0.observe(x, step.clone(), agent, row, after);
        }
        if let Some(y) = y {
            self.1.observe(y, step, agent, row, after);
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

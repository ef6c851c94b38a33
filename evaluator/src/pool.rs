//! Threads that run episodes of a frozen policy side by side.

use std::time::Duration;

use environment::World;
use policy::Policy;
use proto::ActionMode;

use crate::films::EpisodeSelector;
use crate::sequences::{EpisodeResult, EpisodeSpec, Rules, run_sequences};
use crate::setup::{EvalError, EvalSetup};
use crate::work_queue::WorkQueue;

/// How long threads without work wait before they ask whether to go on.
const PATIENCE: Duration = Duration::from_millis(100);

/// Runs sequences with frozen weights, by threads of this process and whoever else takes some from the work queue. Only episodes of
/// this process become films.
#[derive(Clone, Copy)]
pub(crate) struct EvaluationPool<'a> {
    pub(crate) setup: &'a EvalSetup<'a>,
    pub(crate) queue: &'a WorkQueue,
    pub(crate) films: Option<&'a EpisodeSelector>,
    pub(crate) keep_going: &'a (dyn Fn() -> bool + Sync),
}

impl EvaluationPool<'_> {
    /// Runs the sequences; the results have their shape.
    pub(crate) fn run(
        &self,
        sequences: &[Vec<EpisodeSpec>],
        acting: ActionMode,
    ) -> Result<Vec<Vec<EpisodeResult>>, EvalError> {
        self.queue.post(sequences, acting);
        let n_threads = self.setup.episodes.n_threads.min(sequences.len()).max(1);
        let n_worlds = self.setup.episodes.n_worlds.min(sequences.len().div_ceil(n_threads));
        let ended: Result<(), EvalError> = std::thread::scope(|scope| {
            let others: Vec<_> = (1..n_threads).map(|_| scope.spawn(|| self.work(acting, n_worlds))).collect();
            let own = self.work(acting, n_worlds);
            let join = |thread: std::thread::ScopedJoinHandle<'_, _>| {
                thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
            };
            others.into_iter().map(join).fold(own, Result::and)
        });
        let results = self.queue.clear();
        ended.map(|()| results)
    }

    /// Takes sequences from the work queue until all are done.
    fn work(&self, acting: ActionMode, n_worlds: usize) -> Result<(), EvalError> {
        let mut policy = Policy::new(&self.setup.policy)?;
        policy.load(self.queue.weights())?;
        let rules = Rules {
            catalog: self.setup.catalog,
            acting,
            success: &self.setup.environment.success,
            keep_going: self.keep_going,
            films: self.films,
        };
        loop {
            let worlds: Result<Vec<World>, _> = (0..n_worlds).map(|_| World::new(&self.setup.environment)).collect();
            let bring = |sequence_idx, results| self.queue.bring(sequence_idx, results);
            run_sequences(&rules, &policy, worlds?, || self.queue.take(), bring)?;
            if self.queue.is_done() {
                return Ok(());
            }
            // Others have the last sequences; if they do not bring them, somebody must run them.
            self.queue.wait(PATIENCE);
            if !(self.keep_going)() {
                return Err(EvalError::Interrupted);
            }
        }
    }
}

//! A pool of threads that run episodes in parallel.

use std::time::Duration;

use environment::World;
use proto::{ActionMode, Agent};

use crate::report::EpisodeResult;
use crate::sequences::{EpisodeObserver, EpisodeSpec, Rules, run_sequences};
use crate::setup::{EvalError, EvalSetup};
use crate::work_queue::WorkQueue;

/// Time that an idle thread waits before it calls `keep_going`.
const PATIENCE: Duration = Duration::from_millis(100);

/// Runs sequences on threads of this process, while remote workers may take others from the work queue. The observer
/// follows only the episodes of this process.
pub(crate) struct EvaluationPool<'a, A, O> {
    pub(crate) setup: &'a EvalSetup<'a>,
    /// Creates the agent of a thread.
    pub(crate) agent: &'a (dyn Fn() -> Result<A, EvalError> + Sync),
    pub(crate) queue: &'a WorkQueue,
    pub(crate) observer: Option<&'a O>,
    pub(crate) keep_going: &'a (dyn Fn() -> bool + Sync),
}

impl<A: Agent, O: EpisodeObserver<A>> EvaluationPool<'_, A, O>
where
    EvalError: From<A::Error>,
{
    /// Runs the sequences and returns the results in their shape. After an error, only the completed sequences have
    /// results.
    pub(crate) fn run(
        &self,
        sequences: &[Vec<EpisodeSpec>],
        acting: ActionMode,
    ) -> (Vec<Vec<EpisodeResult>>, Result<(), EvalError>) {
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
        (self.queue.clear(), ended)
    }

    /// Runs sequences from the work queue until all are done. After a failure or a panic, gives up the queue, because
    /// the other threads would otherwise wait for the sequences that this thread has taken.
    fn work(&self, acting: ActionMode, n_worlds: usize) -> Result<(), EvalError> {
        let _guard = PanicGuard(self.queue);
        self.try_to_work(acting, n_worlds).inspect_err(|_| self.queue.give_up())
    }

    fn try_to_work(&self, acting: ActionMode, n_worlds: usize) -> Result<(), EvalError> {
        let mut agent = (self.agent)()?;
        let rules = Rules {
            catalog: self.setup.catalog,
            acting,
            success: &self.setup.environment.success,
            keep_going: self.keep_going,
            observer: self.observer,
        };
        loop {
            let worlds: Result<Vec<World>, _> = (0..n_worlds).map(|_| World::new(&self.setup.environment)).collect();
            let bring = |sequence_idx, results| self.queue.bring(sequence_idx, results);
            run_sequences(&rules, &mut agent, worlds?, || self.queue.take(), bring)?;
            if self.queue.is_done() {
                return Ok(());
            }
            // Others have the last sequences. If they do not return them, a thread of this pool must run them.
            self.queue.wait(PATIENCE);
            if !(self.keep_going)() {
                return Err(EvalError::Interrupted);
            }
        }
    }
}

/// Gives up the work queue if the thread that holds this guard panics. The other threads then end, and
/// [`EvaluationPool::run`] passes the panic on.
struct PanicGuard<'a>(&'a WorkQueue);

impl Drop for PanicGuard<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.give_up();
        }
    }
}

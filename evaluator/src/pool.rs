//! A pool of threads that run episodes in parallel.

use std::sync::atomic::{AtomicUsize, Ordering};

use environment::World;
use proto::ActionMode;
use tokio::sync::watch;

use crate::recording::Recorder;
use crate::report::{End, EpisodeResult};
use crate::sequences::{Rules, run_sequences};
use crate::setup::{EvalError, EvalSetup, Performer};
use crate::spec::EpisodeSpec;

/// Progress of an evaluation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EvaluationProgress {
    /// Episodes that have ended, in all action modes and including reset-free runs.
    pub n_ended: u64,
    /// Those of them that succeeded.
    pub n_successes: u64,
    /// Total number of episodes; 0 while there is nothing to evaluate.
    pub n_planned: u64,
}

impl EvaluationProgress {
    fn count(&mut self, episode: &EpisodeResult) {
        self.n_ended += 1;
        self.n_successes += u64::from(matches!(episode.end, End::Success { .. }));
    }
}

/// Runs sequences on threads.
pub(crate) struct EvaluationPool<'a> {
    pub(crate) setup: &'a EvalSetup<'a>,
    pub(crate) performer: Performer<'a>,
    pub(crate) recorder: Option<&'a dyn Recorder>,
    pub(crate) progress: Option<&'a watch::Sender<Option<EvaluationProgress>>>,
    pub(crate) keep_going: &'a (dyn Fn() -> bool + Sync),
}

impl EvaluationPool<'_> {
    pub(crate) fn plan(&self, n_episodes: u64) {
        self.change_progress(|progress| progress.n_planned = n_episodes);
    }

    /// Runs the sequences and returns the results in their shape. After an error, only the completed sequences have
    /// results.
    pub(crate) fn run(
        &self,
        sequences: &[Vec<EpisodeSpec>],
        acting: ActionMode,
    ) -> (Vec<Vec<EpisodeResult>>, Result<(), EvalError>) {
        let n_threads = self.setup.episodes.n_threads.min(sequences.len()).max(1);
        let n_worlds = self.setup.n_worlds.min(sequences.len().div_ceil(n_threads));
        let queue = Queue::new(sequences);
        let work = || {
            let mut completed = Vec::new();
            let ended = self.work(&queue, acting, n_worlds, &mut completed);
            (completed, ended)
        };
        let (mut completed, ended) = std::thread::scope(|scope| {
            let others: Vec<_> = (1..n_threads).map(|_| scope.spawn(work)).collect();
            let (mut completed, mut ended) = work();
            for thread in others {
                let (more, its_end) = thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
                completed.extend(more);
                ended = ended.and(its_end);
            }
            (completed, ended)
        });
        completed.sort_unstable_by_key(|&(sequence_idx, _)| sequence_idx);
        (completed.into_iter().map(|(_, results)| results).collect(), ended)
    }

    /// Runs sequences from the queue until it is empty. Completed sequences go to `completed` with their index.
    fn work(
        &self,
        queue: &Queue<'_>,
        acting: ActionMode,
        n_worlds: usize,
        completed: &mut Vec<(usize, Vec<EpisodeResult>)>,
    ) -> Result<(), EvalError> {
        let _closing = CloseOnDrop(queue);
        let rules = Rules {
            catalog: self.setup.catalog,
            environment: &self.setup.environment,
            performer: self.performer,
            acting,
            keep_going: self.keep_going,
            recorder: self.recorder,
        };
        let worlds = (0..n_worlds).map(|_| World::new(&self.setup.environment)).collect();
        let done = |sequence_idx, results: Vec<EpisodeResult>| {
            self.change_progress(|progress| results.iter().for_each(|result| progress.count(result)));
            completed.push((sequence_idx, results));
        };
        run_sequences(&rules, worlds, || queue.take(), done)
    }

    fn change_progress(&self, change: impl FnOnce(&mut EvaluationProgress)) {
        if let Some(progress) = self.progress {
            progress.send_modify(|progress| change(progress.get_or_insert_default()));
        }
    }
}

/// Hands out each sequence once.
struct Queue<'s> {
    sequences: &'s [Vec<EpisodeSpec>],
    next_idx: AtomicUsize,
}

impl<'s> Queue<'s> {
    fn new(sequences: &'s [Vec<EpisodeSpec>]) -> Self {
        Self { sequences, next_idx: AtomicUsize::new(0) }
    }

    /// Takes the next sequence, with its index.
    fn take(&self) -> Option<(usize, &'s [EpisodeSpec])> {
        // Relaxed: the sequences do not change.
        let sequence_idx = self.next_idx.fetch_add(1, Ordering::Relaxed);
        Some((sequence_idx, self.sequences.get(sequence_idx)?.as_slice()))
    }
}

/// Empties the queue when dropped. A thread that ends leaves an empty queue anyway, unless it failed or panicked: the
/// others then must not run all the rest before [`EvaluationPool::run`] can pass the failure on.
struct CloseOnDrop<'q>(&'q Queue<'q>);

impl Drop for CloseOnDrop<'_> {
    fn drop(&mut self) {
        self.0.next_idx.store(self.0.sequences.len(), Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind};

    use blueprints::{Catalog, Split};
    use proto::Start;

    use super::*;
    use crate::config::EpisodeConfig;
    use crate::episodes::tests::{performer, small_setup};

    /// Sequences of one or two episodes, of different goals.
    fn sequences(n: usize) -> Vec<Vec<EpisodeSpec>> {
        let goals = Catalog::builtin().of_split(Split::Train);
        let sequence = |idx: usize| {
            let starts = [Start::Scattered, Start::AsItIs].into_iter().take(1 + idx % 2);
            starts.map(|start| EpisodeSpec::new(goals[idx], start, 1, 0)).collect()
        };
        (0..n).map(sequence).collect()
    }

    #[test]
    fn nothing_is_handed_out_after_a_panic() {
        let sequences = sequences(3);
        let queue = Queue::new(&sequences);
        let panicking = || {
            let _closing = CloseOnDrop(&queue);
            assert_eq!(queue.take().unwrap().0, 0);
            panic!("out of order");
        };
        catch_unwind(AssertUnwindSafe(panicking)).unwrap_err();
        assert!(queue.take().is_none());
    }

    #[test]
    fn results_come_in_the_order_of_the_sequences_and_are_counted() {
        let setup = EvalSetup { n_worlds: 2, ..small_setup(EpisodeConfig { n_threads: 3, ..Default::default() }) };
        let sequences = sequences(12);
        let progress = watch::Sender::default();
        let pool = EvaluationPool {
            setup: &setup,
            performer: performer(),
            recorder: None,
            progress: Some(&progress),
            keep_going: &|| true,
        };
        pool.plan(30);
        let (results, ended) = pool.run(&sequences, ActionMode::Greedy);
        ended.unwrap();
        let goals = |specs: &Vec<EpisodeSpec>| specs.iter().map(|spec| spec.task.blueprint.clone()).collect();
        let goals: Vec<Vec<_>> = sequences.iter().map(goals).collect();
        let reached = |results: &Vec<EpisodeResult>| results.iter().map(|result| result.blueprint.clone()).collect();
        assert_eq!(results.iter().map(reached).collect::<Vec<Vec<_>>>(), goals);
        let n_successes = results.iter().flatten().filter(|result| matches!(result.end, End::Success { .. })).count();
        let expected = EvaluationProgress { n_ended: 18, n_successes: n_successes as u64, n_planned: 30 };
        assert_eq!(*progress.borrow(), Some(expected));
    }
}

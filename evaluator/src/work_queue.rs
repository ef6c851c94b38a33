//! Holds the sequences of an evaluation until threads of this process or remote workers run them.
//!
//! Each sequence is given to one worker at a time. A sequence that is not returned goes to the next worker that asks;
//! if two workers return the same sequence, the first result counts.

use parking_lot::{Condvar, Mutex, MutexGuard};
use std::sync::Arc;
use std::time::Duration;

use proto::ActionMode;
use tokio::sync::watch;

use crate::report::EpisodeResult;
use crate::sequences::EpisodeSpec;

/// Maximum number of sequences that a remote worker takes at a time: a few seconds of work, which is also the most that
/// must be repeated if it disconnects.
pub(crate) const MAX_LEASED: usize = 64;

/// Progress of an evaluation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EvaluationProgress {
    /// Episodes that have ended, in all action modes and including reset-free runs.
    pub n_ended: u64,
    /// Total number of episodes; 0 while there is nothing to evaluate.
    pub n_planned: u64,
}

/// The work queue of one evaluation.
#[derive(Debug, Default)]
pub(crate) struct WorkQueue {
    table: Mutex<Table>,
    brought: Condvar,
    posted: watch::Sender<()>,
    progress: watch::Sender<EvaluationProgress>,
}

/// The sequences to run with one action mode.
#[derive(Debug, Default)]
struct Table {
    /// Incremented by each `post`; results for an earlier round are ignored.
    round: u64,
    acting: ActionMode,
    sequences: Vec<Sequence>,
    n_missing: usize,
    n_workers: usize,
    n_assisted: u64,
}

#[derive(Debug)]
struct Sequence {
    specs: Arc<[EpisodeSpec]>,
    state: State,
}

#[derive(Debug)]
enum State {
    Waiting,
    Taken,
    Done(Vec<EpisodeResult>),
    /// The result is no longer needed.
    GivenUp,
}

/// Sequences that a remote worker has taken. Those not returned when the lease is dropped become available again.
#[derive(Debug)]
pub(crate) struct Lease {
    queue: Arc<WorkQueue>,
    round: u64,
    /// Action mode to use.
    pub(crate) acting: ActionMode,
    sequences: Vec<(usize, Arc<[EpisodeSpec]>)>,
}

/// Counts a remote worker while the guard lives.
#[derive(Debug)]
pub(crate) struct WorkerGuard(Arc<WorkQueue>);

impl WorkQueue {
    /// Returns the number of sequences that remote workers have run so far.
    pub(crate) fn n_assisted(&self) -> u64 {
        self.table().n_assisted
    }

    /// Sets the total number of episodes.
    pub(crate) fn plan(&self, n_episodes: u64) {
        self.progress.send_modify(|progress| progress.n_planned = n_episodes);
    }

    /// Returns a receiver of the progress.
    pub(crate) fn watch_progress(&self) -> watch::Receiver<EvaluationProgress> {
        self.progress.subscribe()
    }

    /// Replaces the sequences.
    pub(crate) fn post(&self, sequences: &[Vec<EpisodeSpec>], acting: ActionMode) {
        let mut table = self.table();
        table.round += 1;
        table.acting = acting;
        table.n_missing = sequences.len();
        table.sequences =
            sequences.iter().map(|specs| Sequence { specs: specs.as_slice().into(), state: State::Waiting }).collect();
        drop(table);
        self.posted.send_replace(());
    }

    /// Takes the next sequence for a thread of this process.
    pub(crate) fn take(&self) -> Option<(usize, Arc<[EpisodeSpec]>)> {
        self.table().take()
    }

    /// Stores the results of a thread of this process.
    pub(crate) fn bring(&self, sequence_idx: usize, results: Vec<EpisodeResult>) {
        let n_episodes = results.len();
        if self.table().bring(sequence_idx, results) {
            self.count(n_episodes);
        }
        self.brought.notify_all();
    }

    /// Waits until a sequence may be available or all are done, for at most `patience`.
    pub(crate) fn wait(&self, patience: Duration) {
        let is_idle = |table: &mut Table| {
            table.n_missing > 0 && !table.sequences.iter().any(|sequence| matches!(sequence.state, State::Waiting))
        };
        self.brought.wait_while_for(&mut self.table(), is_idle, patience);
    }

    /// Waits until all sequences are done, for at most `patience`.
    #[cfg(test)]
    pub(crate) fn wait_until_done(&self, patience: Duration) {
        self.brought.wait_while_for(&mut self.table(), |table| table.n_missing > 0, patience);
    }

    /// Whether all sequences are done.
    pub(crate) fn is_done(&self) -> bool {
        self.table().n_missing == 0
    }

    /// Gives up the unfinished sequences; results that have arrived are kept.
    pub(crate) fn give_up(&self) {
        let mut table = self.table();
        table.n_missing = 0;
        for sequence in &mut table.sequences {
            if !matches!(sequence.state, State::Done(_)) {
                sequence.state = State::GivenUp;
            }
        }
        drop(table);
        self.brought.notify_all();
    }

    /// Removes all sequences and returns their results in order, without those that are not done.
    pub(crate) fn clear(&self) -> Vec<Vec<EpisodeResult>> {
        let mut table = self.table();
        table.n_missing = 0;
        let sequences = std::mem::take(&mut table.sequences).into_iter();
        sequences
            .filter_map(|sequence| if let State::Done(results) = sequence.state { Some(results) } else { None })
            .collect()
    }

    /// Returns a receiver that is notified of each `post`.
    pub(crate) fn watch(&self) -> watch::Receiver<()> {
        self.posted.subscribe()
    }

    fn count(&self, n_episodes: usize) {
        self.progress.send_modify(|progress| progress.n_ended += n_episodes as u64);
    }

    fn table(&self) -> MutexGuard<'_, Table> {
        self.table.lock()
    }
}

impl Table {
    fn take(&mut self) -> Option<(usize, Arc<[EpisodeSpec]>)> {
        let sequence_idx = self.sequences.iter().position(|sequence| matches!(sequence.state, State::Waiting))?;
        let sequence = &mut self.sequences[sequence_idx];
        sequence.state = State::Taken;
        Some((sequence_idx, sequence.specs.clone()))
    }

    /// Stores the results; returns whether they were needed.
    fn bring(&mut self, sequence_idx: usize, results: Vec<EpisodeResult>) -> bool {
        let Some(sequence) = self.sequences.get_mut(sequence_idx) else { return false };
        if matches!(sequence.state, State::Done(_) | State::GivenUp) {
            return false;
        }
        sequence.state = State::Done(results);
        self.n_missing -= 1;
        true
    }
}

impl WorkerGuard {
    /// Registers a remote worker that takes from this queue.
    pub(crate) fn new(queue: Arc<WorkQueue>) -> Self {
        queue.table().n_workers += 1;
        Self(queue)
    }

    /// Leases up to `at_most` waiting sequences to the worker, if there are any: no more than half of its share, so that
    /// the others have as much left.
    pub(crate) fn take(&self, at_most: usize) -> Option<Lease> {
        let mut table = self.0.table();
        let n_waiting = table.sequences.iter().filter(|sequence| matches!(sequence.state, State::Waiting)).count();
        let n = (n_waiting / (2 * (table.n_workers + 1))).clamp(1, at_most);
        let sequences: Vec<_> = std::iter::from_fn(|| table.take()).take(n).collect();
        let (round, acting) = (table.round, table.acting);
        drop(table);
        (!sequences.is_empty()).then(|| Lease { queue: self.0.clone(), round, acting, sequences })
    }
}

impl Drop for WorkerGuard {
    fn drop(&mut self) {
        self.0.table().n_workers -= 1;
    }
}

impl Lease {
    /// Returns the specs of each sequence.
    pub(crate) fn specs(&self) -> impl Iterator<Item = &Arc<[EpisodeSpec]>> {
        self.sequences.iter().map(|(_, specs)| specs)
    }

    /// Stores the results of the sequences, which have the shape of [`Self::specs`].
    pub(crate) fn bring(mut self, results: Vec<Vec<EpisodeResult>>) {
        let queue = self.queue.clone();
        let mut table = queue.table();
        let sequences = std::mem::take(&mut self.sequences);
        let mut n_episodes = 0;
        if table.round == self.round {
            for ((sequence_idx, _), results) in sequences.into_iter().zip(results) {
                let n_results = results.len();
                if table.bring(sequence_idx, results) {
                    table.n_assisted += 1;
                    n_episodes += n_results;
                }
            }
        }
        drop(table);
        queue.count(n_episodes);
        queue.brought.notify_all();
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        let mut table = self.queue.table();
        if table.round == self.round {
            for (sequence_idx, _) in &self.sequences {
                if let Some(sequence) = table.sequences.get_mut(*sequence_idx)
                    && matches!(sequence.state, State::Taken)
                {
                    sequence.state = State::Waiting;
                }
            }
        }
        drop(table);
        self.queue.brought.notify_all();
    }
}

#[cfg(test)]
mod tests;

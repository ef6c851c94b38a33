//! Where the sequences of an evaluation lie until somebody runs them: threads of this process, or remote workers.
//!
//! Every sequence is given to one at a time. What is not brought back goes to the next who asks; of two who bring the same
//! sequence the first counts.

use parking_lot::{Condvar, Mutex, MutexGuard};
use std::sync::Arc;
use std::time::Duration;

use proto::ActionMode;
use tokio::sync::watch;

use crate::report::EpisodeResult;
use crate::sequences::EpisodeSpec;

/// Most sequences that a remote worker takes at a time: a few seconds of work, and the most that is done again when it is gone.
const MAX_LEASED: usize = 64;

/// How far an evaluation is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EvaluationProgress {
    /// Episodes that have ended, of all ways of acting and of reset-free runs too.
    pub n_ended: u64,
    /// Episodes in all; 0 while there is nothing to evaluate.
    pub n_planned: u64,
}

/// The work of one evaluation.
#[derive(Debug, Default)]
pub(crate) struct WorkQueue {
    table: Mutex<Table>,
    brought: Condvar,
    posted: watch::Sender<()>,
    progress: watch::Sender<EvaluationProgress>,
}

/// The sequences that are run with one way of acting.
#[derive(Debug, Default)]
struct Table {
    /// Counts what was posted; what is brought for an earlier round is of no use any more.
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
    /// Nobody waits for it any more.
    GivenUp,
}

/// Sequences that a remote worker has taken. Those that were not brought when it is dropped are for others.
#[derive(Debug)]
pub(crate) struct Lease {
    queue: Arc<WorkQueue>,
    round: u64,
    /// How actions are to be taken.
    pub(crate) acting: ActionMode,
    sequences: Vec<(usize, Arc<[EpisodeSpec]>)>,
}

/// Counts a remote worker while it lives.
#[derive(Debug)]
pub(crate) struct WorkerGuard(Arc<WorkQueue>);

impl WorkQueue {
    /// Sequences that remote workers have brought so far.
    pub(crate) fn n_assisted(&self) -> u64 {
        self.table().n_assisted
    }

    /// Says how many episodes there will be in all.
    pub(crate) fn plan(&self, n_episodes: u64) {
        self.progress.send_modify(|progress| progress.n_planned = n_episodes);
    }

    /// Follows how many of them have ended.
    pub(crate) fn watch_progress(&self) -> watch::Receiver<EvaluationProgress> {
        self.progress.subscribe()
    }

    /// Puts up sequences in place of those before.
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

    /// The next sequence for a thread of this process.
    pub(crate) fn take(&self) -> Option<(usize, Arc<[EpisodeSpec]>)> {
        self.table().take()
    }

    /// What a thread of this process brings.
    pub(crate) fn bring(&self, sequence_idx: usize, results: Vec<EpisodeResult>) {
        let n_episodes = results.len();
        if self.table().bring(sequence_idx, results) {
            self.count(n_episodes);
        }
        self.brought.notify_all();
    }

    /// Waits until a sequence may be there to take, or all are done; at most for `patience`.
    pub(crate) fn wait(&self, patience: Duration) {
        let is_idle = |table: &mut Table| {
            table.n_missing > 0 && !table.sequences.iter().any(|sequence| matches!(sequence.state, State::Waiting))
        };
        self.brought.wait_while_for(&mut self.table(), is_idle, patience);
    }

    /// Waits until all sequences are done, at most for `patience`.
    #[cfg(test)]
    pub(crate) fn wait_until_done(&self, patience: Duration) {
        self.brought.wait_while_for(&mut self.table(), |table| table.n_missing > 0, patience);
    }

    /// Whether all sequences are done.
    pub(crate) fn is_done(&self) -> bool {
        self.table().n_missing == 0
    }

    /// Waits for nothing any more; what has come is kept.
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

    /// What came of the sequences, in their order; those that are not done are left out.
    pub(crate) fn clear(&self) -> Vec<Vec<EpisodeResult>> {
        let mut table = self.table();
        table.n_missing = 0;
        let sequences = std::mem::take(&mut table.sequences).into_iter();
        sequences
            .filter_map(|sequence| if let State::Done(results) = sequence.state { Some(results) } else { None })
            .collect()
    }

    /// Follows what is posted.
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

    /// Whether it was not there already.
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
    /// A remote worker that takes from this queue.
    pub(crate) fn new(queue: Arc<WorkQueue>) -> Self {
        queue.table().n_workers += 1;
        Self(queue)
    }

    /// Sequences for it, if any wait: no more than leave the others as much to do.
    pub(crate) fn take(&self) -> Option<Lease> {
        let mut table = self.0.table();
        let n_waiting = table.sequences.iter().filter(|sequence| matches!(sequence.state, State::Waiting)).count();
        let n = (n_waiting / (2 * (table.n_workers + 1))).clamp(1, MAX_LEASED);
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
    /// The specs of each sequence.
    pub(crate) fn specs(&self) -> impl Iterator<Item = &Arc<[EpisodeSpec]>> {
        self.sequences.iter().map(|(_, specs)| specs)
    }

    /// What came of the sequences, in the shape of [`Self::specs`].
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

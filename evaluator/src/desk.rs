//! Where the lanes of a pass lie until somebody runs them: threads of this process, or assistants.
//!
//! Every lane is given to one at a time. What is not brought back goes to the next who asks; of two who bring the same
//! lane the first counts.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use proto::Weights;
use tokio::sync::watch;

use crate::lanes::{Job, Played};
use crate::report::Acting;

/// Most lanes that an assistant takes at a time: a few seconds of work, and the most that is done again when it is gone.
const MAX_LENT: usize = 64;

/// The work of one pass.
#[derive(Debug)]
pub(crate) struct Desk {
    weights: Arc<Weights>,
    table: Mutex<Table>,
    brought: Condvar,
    posted: watch::Sender<()>,
}

/// The lanes that are run with one way of acting.
#[derive(Debug)]
struct Table {
    /// Counts what was posted; what is brought for an earlier round is of no use any more.
    round: u64,
    acting: Acting,
    lanes: Vec<Lane>,
    n_missing: usize,
    n_assistants: usize,
    n_assisted: u64,
}

#[derive(Debug)]
struct Lane {
    jobs: Arc<[Job]>,
    state: State,
}

#[derive(Debug)]
enum State {
    Waiting,
    Taken,
    Done(Vec<Played>),
}

/// Lanes that an assistant has taken. Those that were not brought when it is dropped are for others.
#[derive(Debug)]
pub(crate) struct Lent {
    desk: Arc<Desk>,
    round: u64,
    /// How actions are to be taken.
    pub(crate) acting: Acting,
    lanes: Vec<(usize, Arc<[Job]>)>,
}

/// Counts an assistant while it lives.
#[derive(Debug)]
pub(crate) struct Assisting(Arc<Desk>);

impl Desk {
    /// An empty desk for a pass over `weights`.
    pub(crate) fn new(weights: Arc<Weights>) -> Self {
        let table =
            Table { round: 0, acting: Acting::Mode, lanes: Vec::new(), n_missing: 0, n_assistants: 0, n_assisted: 0 };
        Self { weights, table: Mutex::new(table), brought: Condvar::new(), posted: watch::Sender::new(()) }
    }

    /// The frozen weights.
    pub(crate) fn weights(&self) -> &Arc<Weights> {
        &self.weights
    }

    /// Lanes that assistants have brought so far.
    pub(crate) fn n_assisted(&self) -> u64 {
        self.table().n_assisted
    }

    /// Puts up lanes in place of those before.
    pub(crate) fn post(&self, lanes: &[Vec<Job>], acting: Acting) {
        let mut table = self.table();
        table.round += 1;
        table.acting = acting;
        table.n_missing = lanes.len();
        table.lanes = lanes.iter().map(|jobs| Lane { jobs: jobs.as_slice().into(), state: State::Waiting }).collect();
        drop(table);
        self.posted.send_replace(());
    }

    /// The next lane for a thread of this process.
    pub(crate) fn take(&self) -> Option<(usize, Arc<[Job]>)> {
        self.table().take()
    }

    /// What a thread of this process brings.
    pub(crate) fn bring(&self, lane_idx: usize, played: Vec<Played>) {
        self.table().bring(lane_idx, played);
        self.brought.notify_all();
    }

    /// Waits until a lane may be there to take, or all are done; at most for `patience`.
    pub(crate) fn wait(&self, patience: Duration) {
        let is_idle = |table: &mut Table| {
            table.n_missing > 0 && !table.lanes.iter().any(|lane| matches!(lane.state, State::Waiting))
        };
        // Whoever panicked with the lock left the table whole: every change of it is one assignment.
        drop(self.brought.wait_timeout_while(self.table(), patience, is_idle).unwrap_or_else(PoisonError::into_inner));
    }

    /// Waits until all lanes are done, at most for `patience`.
    #[cfg(test)]
    pub(crate) fn wait_until_done(&self, patience: Duration) {
        drop(self.brought.wait_timeout_while(self.table(), patience, |table| table.n_missing > 0));
    }

    /// Whether all lanes are done.
    pub(crate) fn is_done(&self) -> bool {
        self.table().n_missing == 0
    }

    /// What came of the lanes, in their order; those that are not done are left out.
    pub(crate) fn clear(&self) -> Vec<Vec<Played>> {
        let mut table = self.table();
        table.n_missing = 0;
        let lanes = std::mem::take(&mut table.lanes).into_iter();
        lanes.filter_map(|lane| if let State::Done(played) = lane.state { Some(played) } else { None }).collect()
    }

    /// Follows what is posted.
    pub(crate) fn watch(&self) -> watch::Receiver<()> {
        self.posted.subscribe()
    }

    fn table(&self) -> MutexGuard<'_, Table> {
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Table {
    fn take(&mut self) -> Option<(usize, Arc<[Job]>)> {
        let lane_idx = self.lanes.iter().position(|lane| matches!(lane.state, State::Waiting))?;
        let lane = &mut self.lanes[lane_idx];
        lane.state = State::Taken;
        Some((lane_idx, lane.jobs.clone()))
    }

    /// Whether it was not there already.
    fn bring(&mut self, lane_idx: usize, played: Vec<Played>) -> bool {
        let Some(lane) = self.lanes.get_mut(lane_idx) else { return false };
        if matches!(lane.state, State::Done(_)) {
            return false;
        }
        lane.state = State::Done(played);
        self.n_missing -= 1;
        true
    }
}

impl Assisting {
    /// An assistant who works for `desk`.
    pub(crate) fn new(desk: Arc<Desk>) -> Self {
        desk.table().n_assistants += 1;
        Self(desk)
    }

    /// Lanes for it, if any wait: no more than leave the others as much to do.
    pub(crate) fn take(&self) -> Option<Lent> {
        let mut table = self.0.table();
        let n_waiting = table.lanes.iter().filter(|lane| matches!(lane.state, State::Waiting)).count();
        let n = (n_waiting / (2 * (table.n_assistants + 1))).clamp(1, MAX_LENT);
        let lanes: Vec<_> = std::iter::from_fn(|| table.take()).take(n).collect();
        let (round, acting) = (table.round, table.acting);
        drop(table);
        (!lanes.is_empty()).then(|| Lent { desk: self.0.clone(), round, acting, lanes })
    }
}

impl Drop for Assisting {
    fn drop(&mut self) {
        self.0.table().n_assistants -= 1;
    }
}

impl Lent {
    /// The jobs of each lane.
    pub(crate) fn jobs(&self) -> impl Iterator<Item = &Arc<[Job]>> {
        self.lanes.iter().map(|(_, jobs)| jobs)
    }

    /// What came of the lanes, in the shape of [`Self::jobs`].
    pub(crate) fn bring(mut self, played: Vec<Vec<Played>>) {
        let desk = self.desk.clone();
        let mut table = desk.table();
        let lanes = std::mem::take(&mut self.lanes);
        if table.round == self.round {
            for ((lane_idx, _), played) in lanes.into_iter().zip(played) {
                table.n_assisted += u64::from(table.bring(lane_idx, played));
            }
        }
        drop(table);
        desk.brought.notify_all();
    }
}

impl Drop for Lent {
    fn drop(&mut self) {
        let mut table = self.desk.table();
        if table.round == self.round {
            for (lane_idx, _) in &self.lanes {
                if let Some(lane) = table.lanes.get_mut(*lane_idx)
                    && matches!(lane.state, State::Taken)
                {
                    lane.state = State::Waiting;
                }
            }
        }
        drop(table);
        self.desk.brought.notify_all();
    }
}

#[cfg(test)]
mod tests;

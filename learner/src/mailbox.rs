//! The bounded inbox between the bus and the updates: what does not fit or is too old is refused and counted.

use parking_lot::{Condvar, Mutex, MutexGuard};
use std::collections::VecDeque;
use std::time::Duration;

use proto::{Refusal, Trajectory, WeightsVersion};
use serde::{Deserialize, Serialize};

use crate::admission::Admission;
use crate::config::MailboxConfig;

/// A bounded queue of trajectories, shared by the bus (which pushes) and the learner (which takes).
///
/// Pushing never waits for room: it holds a lock for the time of a queue operation and answers.
#[derive(Debug)]
pub struct Mailbox {
    config: MailboxConfig,
    admission: Admission,
    state: Mutex<State>,
    arrived: Condvar,
}

/// What became of all trajectories so far. Every one that arrived is in exactly one of `accepted_total`,
/// `stale_total`, `full_total` and `invalid_total`; `expired_total` are accepted ones that grew too old while waiting.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MailboxCounts {
    /// Taken in.
    pub accepted_total: u64,
    /// Refused: the weights that acted were too old.
    pub stale_total: u64,
    /// Refused: no room.
    pub full_total: u64,
    /// Refused: a rule of the [`Admission`] was broken.
    pub invalid_total: u64,
    /// Dropped after acceptance: too old when their turn came.
    pub expired_total: u64,
}

#[derive(Debug, Default)]
struct State {
    waiting: VecDeque<Trajectory>,
    n_steps: usize,
    version: WeightsVersion,
    counts: MailboxCounts,
    is_closed: bool,
}

impl Mailbox {
    /// An empty mailbox for weights version 0 that accepts what `admission` admits.
    pub fn new(config: MailboxConfig, admission: Admission) -> Self {
        Self { config, admission, state: Mutex::default(), arrived: Condvar::new() }
    }

    /// Puts a trajectory in the queue.
    ///
    /// # Errors
    /// `Stale` when it is more than `max_policy_lag` versions old, `Full` when as many steps wait as may, `Invalid` when
    /// this learner cannot use it at all.
    pub fn push(&self, trajectory: Trajectory) -> Result<(), Refusal> {
        let verdict = self.admission.check(&trajectory);
        let mut state = self.lock();
        if let Err(reason) = verdict {
            state.counts.invalid_total += 1;
            return Err(Refusal::Invalid(reason));
        }
        if policy_lag(state.version, &trajectory) > self.config.max_policy_lag {
            state.counts.stale_total += 1;
            return Err(Refusal::Stale);
        }
        // The last one may exceed the capacity: otherwise one that does not quite fit would keep an update waiting for ever.
        if state.is_closed || state.n_steps >= self.config.capacity_steps {
            state.counts.full_total += 1;
            return Err(Refusal::Full);
        }
        state.counts.accepted_total += 1;
        state.n_steps += trajectory.transitions.len();
        state.waiting.push_back(trajectory);
        self.arrived.notify_all();
        Ok(())
    }

    /// Refuses everything from now on as if it were full, so that nothing is acknowledged that the last checkpoint lacks.
    pub fn close(&self) {
        self.lock().is_closed = true;
    }

    /// Takes the oldest trajectories until they hold `n_steps` steps; empty when there are not that many.
    pub fn take(&self, n_steps: usize) -> Vec<Trajectory> {
        let mut state = self.lock();
        let mut batch = Vec::new();
        let mut taken = 0;
        if state.n_steps < n_steps {
            return batch;
        }
        while taken < n_steps {
            let Some(trajectory) = state.waiting.pop_front() else { break };
            state.n_steps -= trajectory.transitions.len();
            taken += trajectory.transitions.len();
            batch.push(trajectory);
        }
        batch
    }

    /// Waits until `n_steps` steps are there or `patience` is over; true when they are there.
    pub fn wait(&self, n_steps: usize, patience: Duration) -> bool {
        let mut state = self.lock();
        self.arrived.wait_while_for(&mut state, |state| state.n_steps < n_steps, patience);
        state.n_steps >= n_steps
    }

    /// Names the newest weights, and drops what has become too old for them.
    pub fn set_version(&self, version: WeightsVersion) {
        let mut state = self.lock();
        state.version = version;
        let before = state.waiting.len();
        state.waiting.retain(|t| policy_lag(version, t) <= self.config.max_policy_lag);
        state.counts.expired_total += (before - state.waiting.len()) as u64;
        state.n_steps = state.waiting.iter().map(|t| t.transitions.len()).sum();
    }

    /// Steps that wait.
    pub fn n_steps(&self) -> usize {
        self.lock().n_steps
    }

    /// What became of all trajectories so far.
    pub fn counts(&self) -> MailboxCounts {
        self.lock().counts
    }

    /// The counts and copies of all that wait, oldest first, of one moment.
    pub fn snapshot(&self) -> (MailboxCounts, Vec<Trajectory>) {
        let state = self.lock();
        (state.counts, state.waiting.iter().cloned().collect())
    }

    /// Puts back what a checkpoint holds.
    pub(crate) fn restore(&self, version: WeightsVersion, counts: MailboxCounts, waiting: Vec<Trajectory>) {
        let n_steps = waiting.iter().map(|t| t.transitions.len()).sum();
        *self.lock() = State { waiting: waiting.into(), n_steps, version, counts, is_closed: false };
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // Every critical section leaves the queue whole, so a poisoned lock is still usable.
        self.state.lock()
    }
}

/// Versions between the weights that acted and `newest`; 0 for weights newer than that, which a learner sees that was
/// resumed from a checkpoint older than the actors' weights.
pub fn policy_lag(newest: WeightsVersion, trajectory: &Trajectory) -> u64 {
    newest.0.saturating_sub(trajectory.weights_version.0)
}

#[cfg(test)]
mod tests {
    use blueprints::{BlueprintId, Catalog};
    use proto::Status;

    use super::*;
    use crate::fixtures::trajectory;

    fn mailbox(capacity_steps: usize) -> Mailbox {
        let config = MailboxConfig { capacity_steps, max_policy_lag: 2 };
        Mailbox::new(config, Admission::new(Catalog::builtin(), &[], None, 2))
    }

    #[test]
    fn a_closed_mailbox_keeps_what_it_has_and_takes_no_more() {
        let mailbox = mailbox(100);
        mailbox.push(trajectory(2, 5)).unwrap();
        mailbox.close();
        assert_eq!(mailbox.push(trajectory(2, 5)), Err(Refusal::Full));
        assert_eq!((mailbox.snapshot().1.len(), mailbox.counts().full_total), (1, 1));
    }

    #[test]
    fn every_trajectory_is_accounted_for() {
        let mailbox = mailbox(8);
        mailbox.set_version(WeightsVersion(5));
        assert_eq!(mailbox.push(trajectory(4, 5)), Ok(()));
        assert_eq!(mailbox.push(trajectory(4, 3)), Ok(()));
        assert_eq!(mailbox.push(trajectory(1, 2)), Err(Refusal::Stale));
        assert_eq!(mailbox.push(trajectory(3, 5)), Err(Refusal::Full));
        let mut unknown = trajectory(1, 5);
        unknown.task.blueprint = BlueprintId::try_from("16_404".to_owned()).unwrap();
        assert!(matches!(mailbox.push(unknown), Err(Refusal::Invalid(_))));
        let mut diverged = trajectory(1, 5);
        diverged.status = Status::Diverged;
        assert!(matches!(mailbox.push(diverged), Err(Refusal::Invalid(_))));
        let mut one_armed = trajectory(1, 5);
        one_armed.transitions[0].action.choices[1] = None;
        assert!(matches!(mailbox.push(one_armed), Err(Refusal::Invalid(_))));
        // Version 3 is now 3 versions old, one too many.
        mailbox.set_version(WeightsVersion(6));
        let expected =
            MailboxCounts { accepted_total: 2, stale_total: 1, full_total: 1, invalid_total: 3, expired_total: 1 };
        assert_eq!(mailbox.counts(), expected);
        assert_eq!(mailbox.n_steps(), 4);
    }

    #[test]
    fn a_mailbox_of_one_update_fills_up_to_it() {
        let mailbox = mailbox(10);
        for _ in 0..3 {
            mailbox.push(trajectory(4, 0)).unwrap();
        }
        assert_eq!((mailbox.n_steps(), mailbox.push(trajectory(4, 0))), (12, Err(Refusal::Full)));
        assert_eq!(mailbox.take(10).len(), 3);
    }

    #[test]
    fn a_batch_is_whole_or_nothing_and_in_order() {
        let mailbox = mailbox(100);
        for version in 0..3 {
            mailbox.push(trajectory(4, version)).unwrap();
        }
        assert!(mailbox.take(13).is_empty());
        let versions: Vec<_> = mailbox.take(5).iter().map(|t| t.weights_version.0).collect();
        assert_eq!(versions, [0, 1]);
        assert_eq!(mailbox.n_steps(), 4);
        assert!(!mailbox.wait(5, Duration::ZERO));
        assert!(mailbox.wait(4, Duration::ZERO));
    }

    #[test]
    fn weights_from_the_future_have_no_lag() {
        assert_eq!(policy_lag(WeightsVersion(3), &trajectory(1, 7)), 0);
    }

    #[test]
    fn a_waiting_learner_wakes_when_the_last_step_arrives() {
        let mailbox = mailbox(100);
        std::thread::scope(|scope| {
            let waiter = scope.spawn(|| mailbox.wait(8, Duration::from_secs(60)));
            mailbox.push(trajectory(4, 0)).unwrap();
            mailbox.push(trajectory(4, 0)).unwrap();
            assert!(waiter.join().unwrap());
        });
    }
}

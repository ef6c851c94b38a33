//! The bounded queue between the bus and the updates. It refuses and counts trajectories that are invalid, too old, or
//! do not fit.

use parking_lot::{Condvar, Mutex};
use std::collections::VecDeque;
use std::time::Duration;

use proto::{Refusal, Trajectory, WeightsVersion};
use serde::{Deserialize, Serialize};

use crate::admission::Admission;
use crate::config::MailboxConfig;

/// A bounded queue of trajectories, filled by the bus and drained by the learner.
///
/// A push never waits for space: it holds a lock for one queue operation and returns the result.
#[derive(Debug)]
pub struct Mailbox {
    config: MailboxConfig,
    admission: Admission,
    state: Mutex<State>,
    arrived: Condvar,
}

/// Trajectories so far, by result. Each one is in exactly one of `accepted_total`, `stale_total`, `full_total`, and
/// `invalid_total`; `expired_total` counts accepted ones that became too old while waiting.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MailboxCounts {
    /// Accepted.
    pub accepted_total: u64,
    /// Refused because the acting weights were too old.
    pub stale_total: u64,
    /// Refused because the mailbox was full.
    pub full_total: u64,
    /// Refused because they broke a rule of the [`Admission`], or acted with newer weights than there are.
    pub invalid_total: u64,
    /// Dropped after acceptance because they became too old.
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
    /// Creates an empty mailbox at weights version 0 that accepts trajectories according to `admission`.
    pub fn new(config: MailboxConfig, admission: Admission) -> Self {
        Self { config, admission, state: Mutex::default(), arrived: Condvar::new() }
    }

    /// Puts a trajectory in the queue.
    ///
    /// # Errors
    /// `Stale` if it is more than `max_policy_lag` versions old, `Full` if the mailbox is at capacity, and `Invalid` if
    /// this learner cannot use it, or if it acted with weights that this learner has not made yet. An actor still has
    /// such weights for a moment after the learner resumed from an older checkpoint.
    pub fn push(&self, trajectory: Trajectory) -> Result<(), Refusal> {
        self.put(trajectory, self.config.capacity_steps)
    }

    /// As [`Self::push`], but never full: for a sender that waits for the updates anyway and cannot send again.
    ///
    /// # Errors
    /// `Stale` and `Invalid`.
    pub fn push_beyond_capacity(&self, trajectory: Trajectory) -> Result<(), Refusal> {
        self.put(trajectory, usize::MAX)
    }

    fn put(&self, trajectory: Trajectory, capacity_steps: usize) -> Result<(), Refusal> {
        let admitted = self.admission.check(&trajectory);
        let mut state = self.state.lock();
        let (acted, newest) = (trajectory.weights_version, state.version);
        let admitted = admitted.and_then(|()| match acted <= newest {
            true => Ok(()),
            false => Err(format!("its weights {acted} are newer than the newest, {newest}")),
        });
        if let Err(reason) = admitted {
            state.counts.invalid_total += 1;
            return Err(Refusal::Invalid(reason));
        }
        if policy_lag(state.version, &trajectory) > self.config.max_policy_lag {
            state.counts.stale_total += 1;
            return Err(Refusal::Stale);
        }
        // The last trajectory may exceed the capacity: otherwise one that does not fit could block an update forever.
        if state.is_closed || state.n_steps >= capacity_steps {
            state.counts.full_total += 1;
            return Err(Refusal::Full);
        }
        state.counts.accepted_total += 1;
        state.n_steps += trajectory.transitions.len();
        state.waiting.push_back(trajectory);
        self.arrived.notify_all();
        Ok(())
    }

    /// Refuses every trajectory from now on as if full, so that no trajectory is acknowledged but missing from the last
    /// checkpoint.
    pub fn close(&self) {
        self.state.lock().is_closed = true;
    }

    /// Removes and returns the oldest trajectories, with at least `n_steps` steps in total; empty if the mailbox holds
    /// fewer.
    pub fn take(&self, n_steps: usize) -> Vec<Trajectory> {
        let mut state = self.state.lock();
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

    /// Waits until the mailbox holds `n_steps` steps or the timeout expires; returns whether it holds them.
    pub fn wait(&self, n_steps: usize, timeout: Duration) -> bool {
        let mut state = self.state.lock();
        self.arrived.wait_while_for(&mut state, |state| state.n_steps < n_steps, timeout);
        state.n_steps >= n_steps
    }

    /// Sets the newest version, and drops trajectories that are now too old.
    pub fn set_version(&self, version: WeightsVersion) {
        let mut state = self.state.lock();
        state.version = version;
        let before = state.waiting.len();
        state.waiting.retain(|t| policy_lag(version, t) <= self.config.max_policy_lag);
        state.counts.expired_total += (before - state.waiting.len()) as u64;
        state.n_steps = state.waiting.iter().map(|t| t.transitions.len()).sum();
    }

    /// Returns the number of waiting steps.
    pub fn n_steps(&self) -> usize {
        self.state.lock().n_steps
    }

    /// Returns the number of trajectories so far, by result.
    pub fn counts(&self) -> MailboxCounts {
        self.state.lock().counts
    }

    /// Returns a consistent snapshot of the counts and of the waiting trajectories, oldest first.
    pub fn snapshot(&self) -> (MailboxCounts, Vec<Trajectory>) {
        let state = self.state.lock();
        (state.counts, state.waiting.iter().cloned().collect())
    }

    /// Restores the state from a checkpoint.
    pub(crate) fn restore(&self, version: WeightsVersion, counts: MailboxCounts, waiting: Vec<Trajectory>) {
        let n_steps = waiting.iter().map(|t| t.transitions.len()).sum();
        *self.state.lock() = State { waiting: waiting.into(), n_steps, version, counts, is_closed: false };
    }
}

/// Returns the number of versions between the acting weights and `newest`.
pub fn policy_lag(newest: WeightsVersion, trajectory: &Trajectory) -> u64 {
    newest.0.saturating_sub(trajectory.weights_version.0)
}

#[cfg(test)]
mod tests {
    use proto::Status;

    use super::*;
    use crate::tests::fixtures::trajectory;
    use crate::tests::learning::small_setup;

    fn mailbox(capacity_steps: usize) -> Mailbox {
        let config = MailboxConfig { capacity_steps, max_policy_lag: 2 };
        Mailbox::new(config, small_setup(1).admission())
    }

    #[test]
    fn closed_mailbox_keeps_its_trajectories_and_refuses_others() {
        let mailbox = mailbox(100);
        mailbox.push(trajectory(2, 0)).unwrap();
        mailbox.close();
        assert_eq!(mailbox.push(trajectory(2, 0)), Err(Refusal::Full));
        assert_eq!((mailbox.snapshot().1.len(), mailbox.counts().full_total), (1, 1));
    }

    #[test]
    fn every_trajectory_is_counted_once() {
        let mailbox = mailbox(8);
        mailbox.set_version(WeightsVersion(5));
        assert_eq!(mailbox.push(trajectory(4, 5)), Ok(()));
        assert_eq!(mailbox.push(trajectory(4, 3)), Ok(()));
        assert_eq!(mailbox.push(trajectory(1, 2)), Err(Refusal::Stale));
        assert_eq!(mailbox.push(trajectory(3, 5)), Err(Refusal::Full));
        let mut diverged = trajectory(1, 5);
        diverged.status = Status::Diverged;
        assert!(matches!(mailbox.push(diverged), Err(Refusal::Invalid(_))));
        // Version 3 is now 3 versions old, one more than allowed.
        mailbox.set_version(WeightsVersion(6));
        let expected =
            MailboxCounts { accepted_total: 2, stale_total: 1, full_total: 1, invalid_total: 1, expired_total: 1 };
        assert_eq!(mailbox.counts(), expected);
        assert_eq!(mailbox.n_steps(), 4);
    }

    #[test]
    fn mailbox_with_the_capacity_of_one_update_fills_up() {
        let mailbox = mailbox(10);
        for _ in 0..3 {
            mailbox.push(trajectory(4, 0)).unwrap();
        }
        assert_eq!((mailbox.n_steps(), mailbox.push(trajectory(4, 0))), (12, Err(Refusal::Full)));
        assert_eq!(mailbox.take(10).len(), 3);
    }

    #[test]
    fn a_sender_that_cannot_send_again_is_never_refused_for_lack_of_room() {
        let mailbox = mailbox(10);
        for _ in 0..5 {
            mailbox.push_beyond_capacity(trajectory(4, 0)).unwrap();
        }
        assert_eq!((mailbox.n_steps(), mailbox.counts().full_total), (20, 0));
        mailbox.set_version(WeightsVersion(3));
        assert_eq!(mailbox.push_beyond_capacity(trajectory(4, 0)), Err(Refusal::Stale));
    }

    #[test]
    fn take_returns_whole_batches_in_order() {
        let mailbox = mailbox(100);
        mailbox.set_version(WeightsVersion(2));
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
    fn nothing_comes_from_the_future() {
        let mailbox = mailbox(100);
        mailbox.set_version(WeightsVersion(3));
        for version in [4, 1_000_000_000, u64::MAX] {
            let expected = format!("its weights {version} are newer than the newest, 3");
            assert_eq!(mailbox.push(trajectory(1, version)), Err(Refusal::Invalid(expected)));
        }
        assert_eq!(mailbox.push(trajectory(1, 3)), Ok(()));
        assert_eq!((mailbox.counts().invalid_total, mailbox.counts().accepted_total), (3, 1));
    }

    #[test]
    fn wait_returns_when_the_last_step_arrives() {
        let mailbox = mailbox(100);
        std::thread::scope(|scope| {
            let waiter = scope.spawn(|| mailbox.wait(8, Duration::from_secs(60)));
            mailbox.push(trajectory(4, 0)).unwrap();
            mailbox.push(trajectory(4, 0)).unwrap();
            assert!(waiter.join().unwrap());
        });
    }
}

//! Where the trajectories of an update come from.

use std::time::Duration;

use proto::{Trajectory, Weights};

use crate::mailbox::Mailbox;

/// A source of trajectories.
///
/// They all pass through the learner's [`Mailbox`], which refuses what the learner cannot use, counts, and is part of
/// every checkpoint. A source decides who fills it, and when.
pub trait Source: Send {
    /// Returns the oldest trajectories of `mailbox`, with at least `n_steps` environment steps; none if there are not
    /// enough yet. `weights` are the newest.
    ///
    /// Returns after a fraction of a second, because a run can only end between two calls.
    ///
    /// # Errors
    /// If no more trajectories will come.
    fn next(&mut self, mailbox: &Mailbox, weights: &Weights, n_steps: usize) -> anyhow::Result<Vec<Trajectory>>;

    /// Is called at the start, and whenever a checkpoint is due. Where results must not depend on time, the following
    /// trajectories are a function of the weights and of what the mailbox holds.
    fn restart(&mut self) {}
}

/// Maximum time that [`Arrivals`] waits in a call.
const PATIENCE: Duration = Duration::from_millis(100);

/// Trajectories that other processes or threads put into the mailbox.
#[derive(Debug)]
pub struct Arrivals;

impl Source for Arrivals {
    fn next(&mut self, mailbox: &Mailbox, _: &Weights, n_steps: usize) -> anyhow::Result<Vec<Trajectory>> {
        mailbox.wait(n_steps, PATIENCE);
        Ok(mailbox.take(n_steps))
    }
}

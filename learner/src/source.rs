//! Where the trajectories of an update come from.

use std::time::Duration;

use proto::{Trajectory, Weights};

use crate::mailbox::Mailbox;

/// A source of trajectories.
///
/// They all pass through the learner's [`Mailbox`], which refuses what the learner cannot use, counts, and is part of
/// every checkpoint. A source decides who fills it, and when.
pub enum Source {
    /// Other processes or threads fill it, at any time.
    Arrivals,
    /// The learner's own thread does between updates, so that results need not depend on time.
    Made(Make),
}

/// Makes trajectories with the newest weights. With `true`, at the start and whenever a checkpoint is due, all that
/// follows is a function of the weights.
pub type Make = Box<dyn FnMut(&Weights, bool) -> anyhow::Result<Vec<Trajectory>> + Send>;

/// Maximum time to wait for [`Source::Arrivals`]: a run can only end afterwards.
const PATIENCE: Duration = Duration::from_millis(100);

impl Source {
    /// Returns the oldest trajectories of `mailbox`, with at least `n_steps` environment steps; none if there are not
    /// enough yet. `weights` are the newest. Whatever is made resets `restart`.
    pub(crate) fn next(
        &mut self,
        mailbox: &Mailbox,
        weights: &Weights,
        n_steps: usize,
        restart: &mut bool,
    ) -> anyhow::Result<Vec<Trajectory>> {
        match self {
            Self::Arrivals => {
                mailbox.wait(n_steps, PATIENCE);
            }
            Self::Made(make) if mailbox.n_steps() < n_steps => {
                for trajectory in make(weights, std::mem::take(restart))? {
                    // The mailbox counts refusals.
                    let _ = mailbox.push_beyond_capacity(trajectory);
                }
            }
            Self::Made(_) => {}
        }
        Ok(mailbox.take(n_steps))
    }
}

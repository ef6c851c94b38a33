//! Worlds that step in turns with the learner, on its thread.

use std::sync::Arc;

use actor::Lockstep;
use blueprints::Catalog;
use learner::{Mailbox, Source};
use proto::{ActorId, Trajectory, Valid, Weights};

use super::services::actor_setup;
use crate::config::Config;

/// A source of trajectories that equal seeds make equal, byte for byte.
pub(super) struct InProcess {
    worlds: Lockstep,
    restarts: bool,
}

impl InProcess {
    /// Creates the worlds; `catalog` has the goals.
    pub(super) fn new(config: &Valid<Config>, catalog: &Arc<Catalog>) -> Self {
        let id = ActorId::try_from("lockstep".to_owned()).expect("the name is lower case");
        Self { worlds: Lockstep::new(actor_setup(config, id, catalog)), restarts: false }
    }
}

impl Source for InProcess {
    fn next(&mut self, mailbox: &Mailbox, weights: &Weights, n_steps: usize) -> anyhow::Result<Vec<Trajectory>> {
        if mailbox.n_steps() < n_steps {
            for trajectory in self.worlds.step(weights, std::mem::take(&mut self.restarts))? {
                // The mailbox counts refusals.
                let _ = mailbox.push_beyond_capacity(trajectory);
            }
        }
        Ok(mailbox.take(n_steps))
    }

    fn restart(&mut self) {
        self.restarts = true;
    }
}

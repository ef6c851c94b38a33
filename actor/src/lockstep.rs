//! Rollouts that take turns with a learner, on its thread and without the bus, so that equal seeds give equal bytes.

use environment::World;
use proto::{Trajectory, Weights};

use crate::rollout::Rollout;
use crate::setup::ActorSetup;

/// The worlds of one thread, stepped on request.
pub struct Lockstep {
    setup: ActorSetup,
    /// Created with the first weights.
    rollout: Option<Rollout<World>>,
    next_seq: u64,
}

impl Lockstep {
    /// Creates the worlds of one thread, whatever the actor's number of threads. The seed determines tasks and actions.
    pub fn new(setup: ActorSetup) -> Self {
        Self { setup, rollout: None, next_seq: 0 }
    }

    /// Advances every world by one step with `weights` and returns the segments that this finished.
    ///
    /// With `restart`, all episodes are abandoned first, and the new ones depend only on seed and version. Worlds are
    /// not part of a checkpoint: a run that writes one restarts there, so that a run resumed from it stays equal.
    ///
    /// # Errors
    /// If a setting is invalid, the weights are for another network, or no task can be started.
    pub fn step(&mut self, weights: &Weights, restart: bool) -> anyhow::Result<Vec<Trajectory>> {
        let seed = self.setup.seed ^ weights.version.0.rotate_left(32);
        let rollout = match &mut self.rollout {
            Some(rollout) => {
                if rollout.version() != weights.version {
                    rollout.set_weights(weights)?;
                }
                if restart {
                    rollout.restart(seed)?;
                }
                rollout
            }
            none => none.insert(Rollout::new(self.setup.clone(), 0, seed, self.setup.worlds(), weights)?),
        };
        let mut segments = rollout.step()?;
        for segment in &mut segments {
            segment.seq = self.next_seq;
            self.next_seq += 1;
        }
        Ok(segments)
    }
}

//! The threads that step worlds, and their choice of weights.

use std::sync::Arc;

use environment::World;
use policy::{Policy, PolicyError};
use proto::Weights;
use tokio::runtime::Handle;
use tokio::sync::watch;

use super::shared::{Progress, Shared};
use crate::rollout::{Rollout, RolloutError};
use crate::setup::ActorSetup;
use crate::streams::thread_seed;

/// Newest weights as they arrive.
type Arrivals = watch::Receiver<Option<Arc<Weights>>>;

/// Runs a stepping thread of a process that started at `epoch`. It may wait on the runtime that started it.
pub(super) fn step_worlds(
    setup: ActorSetup,
    epoch: u64,
    mut weights: Arrivals,
    shared: &Shared,
    thread_idx: usize,
) -> anyhow::Result<()> {
    let worlds = setup.worlds();
    let Some(first) = first_usable(&setup, &mut weights, shared)? else { return Ok(()) };
    let seed = thread_seed(setup.seed, &setup.id, epoch, first.version, thread_idx);
    let rollout = Rollout::new(setup, epoch, seed, worlds, &first)?;
    let mut stepper = Stepper { rollout, current: first, previous: None };
    while !shared.stop.is_cancelled() {
        if weights.has_changed().unwrap_or(false) {
            stepper.take_newest(&mut weights, shared)?;
        }
        shared.bus.pulse().beat();
        match stepper.rollout.step() {
            Ok(segments) => {
                for segment in segments {
                    // A push to a full backlog may wait for the learner.
                    let _waiting = shared.bus.pulse().waiting();
                    shared.count_shed(shared.backlog.push(segment));
                }
            }
            Err(RolloutError::Policy(error)) if error.is_of_weights() => {
                if !stepper.fall_back(&error, &mut weights, shared)? {
                    return Ok(());
                }
            }
            Err(error) => return Err(error.into()),
        }
        let progress = Progress { counters: stepper.rollout.counters(), version: stepper.rollout.version() };
        shared.progress.lock()[thread_idx] = progress;
    }
    Ok(())
}

/// Waits for the first usable weights; `None` if the actor stops first.
fn first_usable(
    setup: &ActorSetup,
    weights: &mut Arrivals,
    shared: &Shared,
) -> Result<Option<Arc<Weights>>, PolicyError> {
    let mut policy = Policy::new(&setup.policy);
    loop {
        if let Some(newest) = weights.borrow_and_update().clone() {
            match setup.check(&newest).and_then(|()| policy.load(&newest)) {
                Ok(()) => return Ok(Some(newest)),
                Err(error) => {
                    shared.refuse(&newest, &error);
                    if !error.is_of_weights() {
                        return Err(error);
                    }
                }
            }
        }
        if !wait_for_others(weights, shared) {
            return Ok(None);
        }
    }
}

/// Waits for other weights; false if the actor stops first.
fn wait_for_others(weights: &mut Arrivals, shared: &Shared) -> bool {
    let _waiting = shared.bus.pulse().waiting();
    let changed = Handle::current().block_on(shared.stop.run_until_cancelled(weights.changed()));
    changed.is_some_and(|changed| changed.is_ok())
}

/// A rollout and its acting weights.
struct Stepper {
    rollout: Rollout<World>,
    current: Arc<Weights>,
    /// The weights before the current ones, in case those turn out to be unusable in some scene.
    previous: Option<Arc<Weights>>,
}

impl Stepper {
    /// Switches to the newest weights if they are usable.
    fn take_newest(&mut self, weights: &mut Arrivals, shared: &Shared) -> Result<(), RolloutError> {
        let Some(newest) = weights.borrow_and_update().clone() else { return Ok(()) };
        match self.rollout.set_weights(&newest) {
            Ok(()) => self.previous = Some(std::mem::replace(&mut self.current, newest)),
            Err(RolloutError::Policy(error)) => {
                shared.refuse(&newest, &error);
                if !error.is_of_weights() {
                    return Err(error.into());
                }
            }
            Err(error) => return Err(error),
        }
        Ok(())
    }

    /// Falls back to the previous weights, or waits for others if there are none; false if the actor stops first.
    fn fall_back(
        &mut self,
        error: &PolicyError,
        weights: &mut Arrivals,
        shared: &Shared,
    ) -> Result<bool, RolloutError> {
        shared.refuse(&self.current, error);
        if let Some(previous) = self.previous.take() {
            self.rollout.set_weights(&previous)?;
            self.current = previous;
            return Ok(true);
        }
        if !wait_for_others(weights, shared) {
            return Ok(false);
        }
        self.take_newest(weights, shared)?;
        Ok(true)
    }
}

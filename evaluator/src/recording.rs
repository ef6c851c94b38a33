//! An episode written down step by step, so that it can be shown.

use environment::{Step, StepResult};
use proto::{ActorId, Decision, Driver, Outcome, Scene, Status, Task, Trajectory, Transition, WeightsVersion};

use crate::report::EpisodeResult;
use proto::unit::End;

/// The steps of an episode so far.
#[derive(Clone, Debug, Default)]
pub(crate) struct Recording {
    transitions: Vec<Transition>,
}

impl Recording {
    /// Takes a step.
    pub(crate) fn push(&mut self, step: Step) {
        let Step { scene, decision: Decision { action, .. }, result: StepResult { reward, .. } } = step;
        self.transitions.push(Transition { scene, action, behavior_log_prob: 0.0, value: 0.0, reward, label: None });
    }

    /// The episode as a trajectory; without log-probabilities and values, as nobody learns from it. `None` if it has no
    /// step to show.
    pub(crate) fn into_trajectory(
        self,
        actor: ActorId,
        driver: Driver,
        weights_version: WeightsVersion,
        task: &Task,
        last: &Scene,
        result: &EpisodeResult,
    ) -> Option<Trajectory> {
        let status = match result.end {
            End::Success { .. } => Status::Success,
            End::TimeLimit => Status::TimeLimit,
            // A diverged episode has no status of its own on the wire; what was seen of it is cut there.
            End::Diverged => Status::Running,
        };
        let outcome = Outcome {
            success: status == Status::Success,
            n_steps: u16::try_from(result.n_steps).ok()?,
            episode_return: result.episode_return,
        };
        (!self.transitions.is_empty()).then(|| Trajectory {
            actor,
            epoch: 0,
            seq: 0,
            weights_version,
            task: task.clone(),
            driver,
            first_step: 0,
            n_burn_in_steps: 0,
            transitions: self.transitions,
            last_scene: last.clone(),
            status,
            bootstrap_value: 0.0,
            outcome: (status != Status::Running).then_some(outcome),
        })
    }
}

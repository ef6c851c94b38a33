//! Records an episode step by step, for display.

use environment::{Step, StepResult};
use proto::{
    ActorId, BehaviorPolicy, Decision, EpisodeStats, Scene, Status, Task, Trajectory, Transition, WeightsVersion,
};

use crate::report::{End, EpisodeResult};

/// The recorded steps of an episode.
#[derive(Clone, Debug, Default)]
pub(crate) struct Recording {
    transitions: Vec<Transition>,
}

impl Recording {
    /// Adds a step.
    pub(crate) fn push(&mut self, step: Step) {
        let Step { scene, decision: Decision { action, proposals, .. }, result: StepResult { reward, .. } } = step;
        let transition = Transition { scene, action, proposals, behavior_log_prob: 0.0, reward, disturbance: None };
        self.transitions.push(transition);
    }

    /// Returns the episode as a trajectory, without log-probabilities, because it is not used for learning.
    /// Returns `None` if the episode has no steps.
    pub(crate) fn into_trajectory(
        self,
        actor: ActorId,
        behavior_policy: BehaviorPolicy,
        weights_version: WeightsVersion,
        task: &Task,
        last: &Scene,
        result: &EpisodeResult,
    ) -> Option<Trajectory> {
        let status = match result.end {
            End::Success { .. } => Status::Success,
            End::TimeLimit => Status::TimeLimit,
            // Trajectories have no status for a diverged episode, so the recording ends as if cut off.
            End::Diverged => Status::Running,
        };
        let stats = EpisodeStats {
            success: status == Status::Success,
            n_steps: u16::try_from(result.n_steps).ok()?,
            episode_return: result.episode_return,
        };
        (!self.transitions.is_empty()).then(|| Trajectory {
            actor,
            epoch: 0,
            seq: 0,
            weights_version,
            settings_hash: 0,
            task: task.clone(),
            behavior_policy,
            first_step: 0,
            transitions: self.transitions,
            last_scene: last.clone(),
            status,
            episode_stats: (status != Status::Running).then_some(stats),
        })
    }
}

//! Records an episode step by step, for display.

use environment::{Step, StepResult};
use proto::{
    ActionMode, ActorId, BehaviorPolicy, Decision, EpisodeStats, Observation, Scene, Status, Task, Trajectory,
    Transition, WeightsVersion,
};

use crate::report::{End, EpisodeResult};
use crate::sequences::{EpisodeObserver, EpisodeSpec};

/// Who acts in a recording.
#[derive(Clone, Debug)]
pub(crate) struct Credits {
    actor: ActorId,
    behavior_policy: BehaviorPolicy,
    weights_version: WeightsVersion,
}

impl Credits {
    /// Returns the credits of the scripted expert, whose actor is `expert`.
    pub(crate) fn of_expert() -> Self {
        Self::new("expert", BehaviorPolicy::Expert, WeightsVersion(0))
    }

    /// Returns the credits of a policy under the name `actor`, which must be lower case.
    pub(crate) fn of_policy(actor: &str, acting: ActionMode, version: WeightsVersion) -> Self {
        let behavior_policy = match acting {
            ActionMode::Greedy => BehaviorPolicy::Greedy,
            ActionMode::Sampled => BehaviorPolicy::Sampled,
        };
        Self::new(actor, behavior_policy, version)
    }

    fn new(actor: &str, behavior_policy: BehaviorPolicy, weights_version: WeightsVersion) -> Self {
        let actor = ActorId::try_from(actor.to_owned()).expect("the name is lower case");
        Self { actor, behavior_policy, weights_version }
    }
}

/// The recorded steps of an episode.
#[derive(Clone, Debug, Default)]
pub(crate) struct Recording {
    transitions: Vec<Transition>,
}

impl Recording {
    pub(crate) fn push(&mut self, step: Step) {
        let Step { scene, decision: Decision { action, proposals, .. }, result: StepResult { reward, .. } } = step;
        let transition = Transition { scene, action, proposals, behavior_log_prob: 0.0, reward, disturbance: None };
        self.transitions.push(transition);
    }

    /// Returns the episode as a trajectory, without log-probabilities, because it is not used for learning.
    pub(crate) fn into_trajectory(
        self,
        credits: Credits,
        task: &Task,
        last: &Scene,
        result: &EpisodeResult,
    ) -> Trajectory {
        let Credits { actor, behavior_policy, weights_version } = credits;
        let status = match result.end {
            End::Success { .. } => Status::Success,
            End::TimeLimit => Status::TimeLimit,
            // Trajectories have no status for a diverged episode, so the recording ends as if cut off.
            End::Diverged => Status::Running,
        };
        let stats = EpisodeStats {
            success: status == Status::Success,
            n_steps: u16::try_from(result.n_steps).expect("the time limit has 16 bits"),
            episode_return: result.episode_return,
        };
        Trajectory {
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
        }
    }
}

/// Records every episode.
pub(crate) struct Recorder<'r> {
    pub(crate) credits: Credits,
    /// Gets each episode with the index of its sequence and its result.
    pub(crate) keep: &'r (dyn Fn(usize, Trajectory, &EpisodeResult) + Sync),
}

impl EpisodeObserver for Recorder<'_> {
    type Record = (usize, Recording);

    fn begin(&self, sequence_idx: usize, _: &EpisodeSpec, _: ActionMode, _: Observation<'_>) -> Option<Self::Record> {
        Some((sequence_idx, Recording::default()))
    }

    fn observe(&self, (_, recording): &mut Self::Record, step: Step, _: Observation<'_>) {
        recording.push(step);
    }

    fn end(&self, (idx, recording): Self::Record, spec: &EpisodeSpec, last: &Scene, result: &EpisodeResult) {
        (self.keep)(idx, recording.into_trajectory(self.credits.clone(), &spec.task, last, result), result);
    }
}

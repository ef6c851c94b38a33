//! Episodes that are recorded step by step, for display.

use proto::{
    ActionMode, ActorId, BehaviorPolicy, EpisodeStats, Scene, Status, Task, Trajectory, Transition, WeightsVersion,
};

use crate::report::{End, EpisodeResult};
use crate::setup::Performer;
use crate::spec::EpisodeSpec;

/// Chooses the episodes to record, and gets the recordings.
pub(crate) trait Recorder: Sync {
    /// Whether an episode that begins now is recorded.
    fn wants(&self, spec: &EpisodeSpec, acting: ActionMode) -> bool;

    /// Takes a recorded episode of this sequence, which has ended.
    fn keep(&self, sequence_idx: usize, episode: Trajectory, result: &EpisodeResult);
}

/// Records every episode.
impl<F: Fn(usize, Trajectory, &EpisodeResult) + Sync> Recorder for F {
    fn wants(&self, _: &EpisodeSpec, _: ActionMode) -> bool {
        true
    }

    fn keep(&self, sequence_idx: usize, episode: Trajectory, result: &EpisodeResult) {
        self(sequence_idx, episode, result);
    }
}

/// Returns an episode that has ended; its actor is `expert` or `policy`.
pub(crate) fn trajectory(
    performer: Performer<'_>,
    task: &Task,
    transitions: Vec<Transition>,
    last: &Scene,
    result: &EpisodeResult,
) -> Trajectory {
    let (actor, behavior_policy, weights_version) = match (performer, result.acting) {
        (Performer::Expert, _) => ("expert", BehaviorPolicy::Expert, WeightsVersion(0)),
        (Performer::Policy(_, weights), ActionMode::Greedy) => ("policy", BehaviorPolicy::Greedy, weights.version),
        (Performer::Policy(_, weights), ActionMode::Sampled) => ("policy", BehaviorPolicy::Sampled, weights.version),
    };
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
        actor: ActorId::try_from(actor.to_owned()).expect("the name is lower case"),
        epoch: 0,
        seq: 0,
        weights_version,
        settings_hash: 0,
        task: task.clone(),
        behavior_policy,
        first_step: 0,
        transitions,
        last_scene: last.clone(),
        status,
        episode_stats: (status != Status::Running).then_some(stats),
    }
}

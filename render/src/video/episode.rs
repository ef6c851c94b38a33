//! An episode, or a part of it, from its recording.

use blueprints::{BlockIdx, Blueprint, BlueprintId, N_BLOCKS};
use nalgebra::{UnitQuaternion, Vector3};
use proto::{Joint, Pose, RewardTerms, Scene, Status, Trajectory};

/// Length of a control step in seconds. Trajectories do not contain it, so all worlds are shown at this pace.
pub const STEP_S: f32 = 0.1;

/// All scenes of an episode, or of a part of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Episode {
    goal: Blueprint,
    first_step: usize,
    /// One more scene than steps.
    scenes: Vec<Scene>,
    /// Cumulative reward before each scene, by term.
    returns: Vec<RewardTerms>,
    status: Status,
}

/// The given blueprint is not the goal of the trajectory.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the goal is {expected}, not {given}")]
pub struct OtherGoal {
    expected: BlueprintId,
    given: BlueprintId,
}

impl Episode {
    /// Takes the episode from its recording; `goal` is its blueprint from the catalog.
    ///
    /// # Errors
    /// Returns an error if `goal` is another blueprint.
    pub fn new(recording: &Trajectory, goal: &Blueprint) -> Result<Self, OtherGoal> {
        let Trajectory { task, first_step, transitions, last_scene, status, .. } = recording;
        if task.blueprint != *goal.id() {
            return Err(OtherGoal { expected: task.blueprint.clone(), given: goal.id().clone() });
        }
        let mut scenes = Vec::new();
        let mut returns = vec![RewardTerms::default()];
        let mut so_far = RewardTerms::default();
        for transition in transitions {
            scenes.push(transition.scene.clone());
            so_far = so_far + transition.reward;
            returns.push(so_far);
        }
        scenes.push(last_scene.clone());
        let goal = goal.permuted(&task.assignment);
        Ok(Self { goal, first_step: usize::from(*first_step), scenes, returns, status: *status })
    }

    /// Returns the goal with the blocks of this episode.
    pub fn goal(&self) -> &Blueprint {
        &self.goal
    }

    /// Returns the index of the first step shown, from 0.
    pub fn first_step(&self) -> usize {
        self.first_step
    }

    /// Returns the number of steps.
    pub fn n_steps(&self) -> usize {
        self.scenes.len() - 1
    }

    /// Returns the status after the last step; `Running` if the recording ends before the episode.
    pub fn status(&self) -> Status {
        self.status
    }

    /// Returns the length in seconds of simulated time.
    pub fn length_s(&self) -> f32 {
        self.n_steps() as f32 * STEP_S
    }

    /// Returns the number of steps finished at a time in seconds.
    pub(super) fn n_done(&self, time_s: f32) -> usize {
        // A thousandth of a step compensates rounding in accumulated times.
        ((time_s / STEP_S + 1e-3).max(0.0) as usize).min(self.n_steps())
    }

    /// Returns the cumulative reward of the first `n_done` steps by term.
    pub fn return_after(&self, n_done: usize) -> RewardTerms {
        self.returns[n_done]
    }

    /// Returns all scenes.
    pub fn scenes(&self) -> &[Scene] {
        &self.scenes
    }

    /// Returns the number of the goal's connections that exist after `n_done` steps.
    pub fn n_connected(&self, n_done: usize) -> usize {
        let is_right = |joint: &&Joint| joint.is_right(&self.goal);
        self.scenes[n_done].joints.iter().filter(is_right).count()
    }

    /// Returns how far the episode is after `n_done` steps, for captions.
    pub(super) fn progress(&self, n_done: usize) -> String {
        let step = self.first_step + n_done;
        format!("step {step}: {}/{} connected", self.n_connected(n_done), self.goal.links().len())
    }

    /// Returns the number of frames, `fps` (at least 1) per second, with the last scene for `last_s` more seconds.
    pub(super) fn n_frames(&self, fps: u32, last_s: f32) -> usize {
        let per_second = fps.max(1) as f32;
        (self.length_s() * per_second).ceil() as usize + 1 + (last_s * per_second) as usize
    }

    /// Returns the largest piece of the goal that is assembled after `n_done` steps. Of pieces of equal size, returns
    /// the one with the lowest block index. Empty if no blocks are connected.
    pub(super) fn largest_piece(&self, n_done: usize) -> Vec<BlockIdx> {
        let pieces = self.scenes[n_done].pieces(&self.goal);
        let members = |piece: usize| BlockIdx::all().filter(move |block| pieces[block.get()] == piece);
        let largest = (0..N_BLOCKS).rev().max_by_key(|piece| members(*piece).count());
        largest.map(|piece| members(piece).collect()).filter(|piece: &Vec<_>| piece.len() > 1).unwrap_or_default()
    }

    /// Returns the scene at a time in seconds; block poses are interpolated between steps.
    pub(super) fn scene_at(&self, time_s: f32) -> Scene {
        let n_done = self.n_done(time_s);
        let before = &self.scenes[n_done];
        let share = (time_s / STEP_S - n_done as f32).clamp(0.0, 1.0);
        let Some(after) = self.scenes.get(n_done + 1).filter(|_| share >= 1e-3) else { return before.clone() };
        let blocks = std::array::from_fn(|i| between(&before.blocks[i], &after.blocks[i], share));
        Scene { blocks, ..after.clone() }
    }
}

/// Interpolates between two poses at `share`, 0 to 1.
fn between(before: &Pose, after: &Pose, share: f32) -> Pose {
    let [from, to] = [before, after].map(|pose| Vector3::from(pose.position));
    let [turn_from, turn_to] = [before, after].map(|pose| UnitQuaternion::new_normalize(pose.orientation.into()));
    // A half turn within a step has no shortest path; no block turns that fast.
    let turn = turn_from.try_slerp(&turn_to, share, 1e-6).unwrap_or(turn_to);
    Pose { position: from.lerp(&to, share).into(), orientation: turn.coords.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pose_is_interpolated_halfway() {
        let before = Pose { position: [0.0, 1.0, 0.0], orientation: [0.0, 0.0, 0.0, 1.0] };
        // A quarter turn around z: half of it is an eighth of a turn, sin 22.5° = 0.3827.
        let half = std::f32::consts::FRAC_1_SQRT_2;
        let after = Pose { position: [0.4, 1.0, 0.2], orientation: [0.0, 0.0, half, half] };
        let pose = between(&before, &after, 0.5);
        let expected = [0.2, 1.0, 0.1, 0.0, 0.0, 0.3827, 0.9239];
        let found = [&pose.position[..], &pose.orientation].concat();
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-4), "{found:?}");
    }
}

//! An episode to look at: recorded from the actors when a browser asks for one, and only then.
//!
//! Actors make copies of their trajectories only while somebody watches, so nobody watches longer than it takes.

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use axum::body::Bytes;
use blueprints::{BlockIdx, Catalogue, Inventory, UNIT_M};
use proto::bus::Bus;
use proto::{RewardTerms, Scene, Status, Trajectory};
use serde::Serialize;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use crate::picture::TYPE_COLORS;
use crate::video::{Collector, Episode, STEP_S};

/// Version of `/api/replay`.
const SCHEMA_VERSION: u32 = 1;

/// Longest time that the actors are watched for one episode.
const PATIENCE: Duration = Duration::from_secs(60);

/// The newest episode, and whether another is wanted.
#[derive(Debug, Default)]
pub(super) struct Replays {
    wanted: Notify,
    newest: Mutex<Option<Bytes>>,
}

/// An episode as it is sent.
#[derive(Debug, Serialize)]
struct ReplayView {
    schema_version: u32,
    actor: String,
    weights_version: u64,
    blueprint: String,
    /// `success` or `time limit`.
    end: &'static str,
    /// Time between two scenes in seconds.
    step_s: f32,
    /// Edge of a unit cell, metres. In the middle of each on a block's sides is a magnet, positive on the sides +x, +y, +z.
    unit_m: f32,
    /// Half the length of each block along its axes, metres.
    half_extents_m: Vec<[f32; 3]>,
    /// Colour of each block's type.
    colors: Vec<[u8; 3]>,
    /// The goal's blocks: index, position in metres in the goal's frame, quaternion x, y, z, w.
    goal: Vec<(usize, [f32; 7])>,
    scenes: Vec<SceneView>,
}

#[derive(Debug, Serialize)]
struct SceneView {
    /// Position in metres and quaternion x, y, z, w of each block, world frame, z up.
    blocks: Vec<[f32; 7]>,
    /// What each gripper holds.
    held: Vec<Option<usize>>,
    /// The goal's connections that are there.
    n_connected: usize,
    /// Undiscounted reward so far.
    reward: f32,
    /// The same by term.
    reward_terms: RewardTerms,
}

impl Replays {
    /// The newest episode, if any; a newer one will be recorded.
    pub(super) fn ask(&self) -> Option<Bytes> {
        self.wanted.notify_one();
        self.newest.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Records whenever it was asked for, one episode at a time, until `shutdown`.
    pub(super) async fn run(&self, bus: Bus, shutdown: CancellationToken) {
        loop {
            tokio::select! {
                () = shutdown.cancelled() => return,
                () = self.wanted.notified() => {}
            }
            let watched = async {
                let mut viewer = bus.trajectory_viewer(None).await.ok()?;
                tokio::time::timeout(PATIENCE, Collector::default().next_episode(&mut viewer)).await.ok()?
            };
            let segments = tokio::select! {
                () = shutdown.cancelled() => return,
                segments = watched => segments,
            };
            match segments.as_deref().and_then(view).map(|view| serde_json::to_vec(&view)) {
                Some(Ok(json)) => {
                    *self.newest.lock().unwrap_or_else(PoisonError::into_inner) = Some(json.into());
                }
                Some(Err(error)) => tracing::debug!(%error, "an episode could not be shown"),
                None => tracing::debug!("no episode was recorded"),
            }
        }
    }
}

/// `None` for a goal that this program's catalogue lacks.
fn view(segments: &[Trajectory]) -> Option<ReplayView> {
    let first = segments.first()?;
    let episode = Episode::new(segments, Catalogue::builtin().get(&first.task.blueprint)?).ok()?;
    let inventory = Inventory::standard();
    let goal = episode.goal().placements().iter().map(|placement| {
        let turn = placement.rotation.quaternion();
        (placement.block.get(), pose(placement.position_m().into(), turn.coords.into()))
    });
    let scenes = episode.scenes().iter().enumerate();
    Some(ReplayView {
        schema_version: SCHEMA_VERSION,
        actor: first.actor.to_string(),
        weights_version: first.weights_version.0,
        blueprint: first.task.blueprint.to_string(),
        end: if episode.status() == Status::Success { "success" } else { "time limit" },
        step_s: STEP_S,
        unit_m: UNIT_M,
        half_extents_m: BlockIdx::all().map(|block| inventory.half_extents_m(block)).collect(),
        colors: BlockIdx::all().map(|block| TYPE_COLORS[inventory.type_idx(block)]).collect(),
        goal: goal.collect(),
        scenes: scenes
            .map(|(n_done, scene)| SceneView::new(scene, episode.n_connected(n_done), episode.return_after(n_done)))
            .collect(),
    })
}

/// Rounded to a tenth of a millimetre, for a third of the length.
fn pose(position: [f32; 3], orientation: [f32; 4]) -> [f32; 7] {
    let round = |x: f32| (x * 1e4).round() / 1e4;
    let ([x, y, z], [qx, qy, qz, qw]) = (position, orientation);
    [x, y, z, qx, qy, qz, qw].map(round)
}

impl SceneView {
    fn new(scene: &Scene, n_connected: usize, reward_terms: RewardTerms) -> Self {
        Self {
            blocks: scene.blocks.iter().map(|block| pose(block.position, block.orientation)).collect(),
            held: scene.grippers.iter().flatten().map(|gripper| gripper.held.map(BlockIdx::get)).collect(),
            n_connected,
            reward: reward_terms.total(),
            reward_terms,
        }
    }
}

#[cfg(test)]
mod tests {
    use proto::{Action, Gripper, Outcome, Pose, RewardTerms, Start, Task, Transition, WeightsVersion};

    use super::*;

    /// `n_steps` steps of an episode; the last segment of it if `ends`.
    fn segment(seed: u64, first_step: u16, n_steps: usize, ends: bool) -> Trajectory {
        let scene = |height: f32| Scene {
            blocks: std::array::from_fn(|_| Pose {
                position: [0.0, 0.123_456, height],
                orientation: [0.0, 0.0, 0.0, 1.0],
            }),
            speeds_mps: [0.0; 16],
            joints: Vec::new(),
            grippers: [
                Some(Gripper {
                    held: BlockIdx::all().nth(3),
                    orientation: [0.0, 0.0, 0.0, 1.0],
                    linear_velocity: [0.0; 3],
                    angular_velocity: [0.0; 3],
                }),
                None,
            ],
            n_heavy_contacts: 0,
        };
        let reward = RewardTerms { connected: 0.5, ..RewardTerms::default() };
        let transition = |i: usize| Transition {
            scene: scene(i as f32),
            action: Action { choices: [None, None], moves: [[0.0; 6]; 16] },
            behavior_log_prob: 0.0,
            value: 0.0,
            reward,
            label: None,
        };
        Trajectory {
            actor: "a".parse().unwrap(),
            epoch: 1,
            seq: 0,
            weights_version: WeightsVersion(7),
            task: Task {
                blueprint: "2_000".parse().unwrap(),
                assignment: BlockIdx::all().collect::<Vec<_>>().try_into().unwrap(),
                start: Start::Scattered,
                seed,
            },
            driver: proto::Driver::Sample,
            first_step,
            transitions: (0..n_steps).map(transition).collect(),
            last_scene: scene(9.0),
            status: if ends { Status::Success } else { Status::Running },
            bootstrap_value: 0.0,
            outcome: ends.then_some(Outcome { success: true, n_steps: 3, episode_return: reward }),
        }
    }

    #[test]
    fn a_hand_worked_replay() {
        let segments = [segment(2, 0, 2, false), segment(2, 2, 1, true)];
        let json = serde_json::to_value(view(&segments).unwrap()).unwrap();
        assert_eq!(
            (&json["blueprint"], &json["end"], &json["weights_version"]),
            (&"2_000".into(), &"success".into(), &7.into())
        );
        assert_eq!(json["goal"].as_array().unwrap().len(), 2);
        // Three steps are four scenes, each step worth 0.5.
        let scenes = json["scenes"].as_array().unwrap();
        let rewards: Vec<f64> = scenes.iter().map(|scene| scene["reward"].as_f64().unwrap()).collect();
        assert_eq!(rewards, [0.0, 0.5, 1.0, 1.5]);
        assert_eq!(scenes[3]["reward_terms"]["connected"], 1.5);
        assert_eq!(scenes[3]["reward_terms"]["wrong"], 0.0);
        assert_eq!(scenes[0]["held"], serde_json::json!([3]));
        let y = scenes[0]["blocks"][0][1].as_f64().unwrap();
        assert!((y - 0.1235).abs() < 1e-6, "{y}");
    }
}

//! Episode replays, recorded from the actors on request.
//!
//! Actors publish copies of their trajectories only while someone subscribes, so a subscription lasts for one episode
//! only.

use parking_lot::Mutex;
use std::sync::Arc;
use std::time::Duration;

use axum::body::Bytes;
use blueprints::drawing::word;
use blueprints::{BlockIdx, Blueprint, Catalog, Inventory, Placement, UNIT_M};
use bus::Bus;
use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};
use proto::{RewardTerms, Scene, Status, Trajectory};
use serde::Serialize;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use super::attention::{AttentionView, Observer};
use render::picture::{GRIPPER_COLORS, TYPE_COLORS};
use render::video::{Collector, Episode, STEP_S};

/// Schema version of `/api/replay`.
const SCHEMA_VERSION: u32 = 1;

/// Longest time to wait for one episode from the actors.
const PATIENCE: Duration = Duration::from_secs(60);

/// The newest episode, and whether another one is requested.
#[derive(Debug)]
pub(super) struct Replays {
    observer: Observer,
    /// The goals of the run.
    catalog: Arc<Catalog>,
    wanted: Notify,
    newest: Mutex<Option<Bytes>>,
}

/// An episode as sent to the browser.
#[derive(Debug, Serialize)]
struct ReplayView {
    schema_version: u32,
    actor: String,
    weights_version: u64,
    blueprint: String,
    title: String,
    /// `success`, `time limit`, or `cut short` for an episode whose physics diverged.
    end: &'static str,
    /// Time between two scenes in seconds.
    step_s: f32,
    /// Edge of a unit cell, meters. Each cell face on a block's surface has a magnet in its center, positive on the
    /// sides +x, +y, +z.
    unit_m: f32,
    /// Name of each block, such as `cube 2`.
    names: Vec<String>,
    /// Half the length of each block along its axes, meters.
    half_extents_m: Vec<[f32; 3]>,
    /// Color of each block's type.
    colors: Vec<[u8; 3]>,
    /// Color of each gripper, as in the videos.
    gripper_colors: Vec<[u8; 3]>,
    /// The goal's blocks: index, position in meters in the goal's frame, quaternion x, y, z, w.
    goal: Vec<(usize, [f32; 7])>,
    /// The pairs of blocks that the goal connects.
    links: Vec<[usize; 2]>,
    scenes: Vec<SceneView>,
    /// The steps in which somebody outside moved or pushed a block, and the block.
    disturbances: Vec<(usize, usize)>,
    attention: Option<AttentionView>,
}

#[derive(Debug, Serialize)]
struct SceneView {
    /// Position in meters and quaternion x, y, z, w of each block, world frame, z up.
    blocks: Vec<[f32; 7]>,
    /// The block held by each gripper.
    held: Vec<Option<usize>>,
    /// Pose of the goal's frame, according to the largest correctly assembled piece of the goal.
    goal_frame: [f32; 7],
    /// Number of the goal's connections that are made.
    n_connected: usize,
    /// Connected pairs of blocks, and whether the goal connects them like this.
    joints: Vec<(usize, usize, bool)>,
    /// Undiscounted reward so far.
    reward: f32,
    /// The reward so far by term.
    reward_terms: RewardTerms,
}

impl Replays {
    /// Creates an empty recorder of episodes with the goals in `catalog`.
    pub(super) fn new(observer: Observer, catalog: Arc<Catalog>) -> Self {
        Self { observer, catalog, wanted: Notify::default(), newest: Mutex::default() }
    }

    /// Returns the JSON of a recorded episode whose goal is in the catalog; `None` if it cannot be shown.
    pub(super) fn show_known(&self, recording: &Trajectory) -> Option<Bytes> {
        self.show(recording, self.catalog.get(&recording.task.blueprint)?)
    }

    /// Returns the JSON of a recorded episode with this goal; `None` if it cannot be shown. Takes around ten
    /// milliseconds.
    pub(super) fn show(&self, recording: &Trajectory, goal: &Blueprint) -> Option<Bytes> {
        let view = view(recording, goal, |episode| self.observer.look(episode))?;
        let json = serde_json::to_vec(&view);
        Some(json.inspect_err(|error| tracing::debug!(%error, "an episode could not be shown")).ok()?.into())
    }

    /// Returns the newest episode, if any, and requests the recording of a newer one.
    pub(super) fn ask(&self) -> Option<Bytes> {
        self.wanted.notify_one();
        self.newest.lock().clone()
    }

    /// Records an episode on request, one at a time, until `shutdown`.
    pub(super) async fn run(self: Arc<Self>, bus: Bus, shutdown: CancellationToken) {
        while shutdown.run_until_cancelled(self.wanted.notified()).await.is_some() {
            let watched = async {
                let mut viewer = bus.trajectory_viewer().await.ok()?;
                let mut collector = Collector::default();
                let episode = async {
                    loop {
                        if let Some(episode) = collector.add(viewer.recv().await?) {
                            return Some(episode);
                        }
                    }
                };
                tokio::time::timeout(PATIENCE, episode).await.ok()?
            };
            let Some(recording) = shutdown.run_until_cancelled(watched).await else { return };
            let replays = self.clone();
            let json = tokio::task::spawn_blocking(move || replays.show_known(&recording?)).await;
            match json.ok().flatten() {
                Some(json) => *self.newest.lock() = Some(json),
                None => tracing::debug!("no episode was recorded"),
            }
        }
    }
}

/// Returns `None` for an episode that has another goal.
fn view(
    recording: &Trajectory,
    goal: &Blueprint,
    look: impl FnOnce(&Episode) -> Option<AttentionView>,
) -> Option<ReplayView> {
    let episode = Episode::new(recording, goal).ok()?;
    let inventory = Inventory::standard();
    let places = episode.goal().placements().iter().map(|placement| {
        let turn = placement.rotation.quaternion();
        (placement.block.get(), pose(placement.position_m().into(), turn.coords.into()))
    });
    let scenes = episode.scenes().iter().enumerate();
    let steps = (episode.first_step()..).zip(&recording.transitions);
    Some(ReplayView {
        schema_version: SCHEMA_VERSION,
        actor: recording.actor.to_string(),
        weights_version: recording.weights_version.0,
        blueprint: recording.task.blueprint.to_string(),
        title: goal.title().to_owned(),
        end: match episode.status() {
            Status::Success => "success",
            Status::TimeLimit => "time limit",
            Status::Running | Status::Diverged => "cut short",
        },
        step_s: STEP_S,
        unit_m: UNIT_M,
        names: BlockIdx::all().map(|block| name(inventory, block)).collect(),
        half_extents_m: BlockIdx::all().map(|block| inventory.half_extents_m(block)).collect(),
        colors: BlockIdx::all().map(|block| TYPE_COLORS[inventory.type_idx(block)]).collect(),
        gripper_colors: GRIPPER_COLORS.to_vec(),
        goal: places.collect(),
        links: episode.goal().links().iter().map(|link| [link.a, link.b].map(BlockIdx::get)).collect(),
        scenes: scenes.map(|(n_done, scene)| SceneView::new(&episode, n_done, scene)).collect(),
        disturbances: steps.filter_map(|(step, t)| Some((step, t.disturbance?.block().get()))).collect(),
        attention: look(&episode),
    })
}

/// Returns the word for the block's type, and its number among the blocks of that type.
fn name(inventory: &Inventory, block: BlockIdx) -> String {
    let number = inventory.same_type(block).take_while(|other| *other <= block).count();
    format!("{} {number}", word(inventory.block_type(block).name))
}

/// Returns the pose of the goal's frame according to one block: of those in the largest correct piece, the lowest one of
/// the goal.
fn goal_frame(goal: &Blueprint, scene: &Scene) -> [f32; 7] {
    let pieces = scene.pieces(goal);
    let size = |block: BlockIdx| pieces.iter().filter(|&&piece| piece == pieces[block.get()]).count();
    let place = |p: &&Placement| (std::cmp::Reverse(size(p.block)), p.center_half_units[2], p.block);
    let first = goal.placements().iter().min_by_key(place);
    let Some(placement) = first else { return pose([0.0; 3], [0.0, 0.0, 0.0, 1.0]) };
    let at = &scene.blocks[placement.block.get()];
    let turn = UnitQuaternion::new_normalize(Quaternion::from(at.orientation));
    let frame = Isometry3::from_parts(Vector3::from(at.position).into(), turn)
        * Isometry3::from_parts(placement.position_m().into(), placement.rotation.quaternion()).inverse();
    pose(frame.translation.vector.into(), frame.rotation.coords.into())
}

/// Rounds to a tenth of a millimeter, which cuts the JSON to a third of its length.
fn pose(position: [f32; 3], orientation: [f32; 4]) -> [f32; 7] {
    let round = |x: f32| (x * 1e4).round() / 1e4;
    let ([x, y, z], [qx, qy, qz, qw]) = (position, orientation);
    [x, y, z, qx, qy, qz, qw].map(round)
}

impl SceneView {
    fn new(episode: &Episode, n_done: usize, scene: &Scene) -> Self {
        let reward_terms = episode.return_after(n_done);
        let joints = scene.joints.iter();
        Self {
            blocks: scene.blocks.iter().map(|block| pose(block.position, block.orientation)).collect(),
            goal_frame: goal_frame(episode.goal(), scene),
            held: scene.grippers.iter().flatten().map(|gripper| gripper.held.map(BlockIdx::get)).collect(),
            joints: joints.map(|joint| (joint.a.get(), joint.b.get(), joint.is_right(episode.goal()))).collect(),
            n_connected: episode.n_connected(n_done),
            reward: reward_terms.total(),
            reward_terms,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::recording;
    use super::*;

    #[test]
    fn a_hand_worked_replay() {
        let mut recording = recording();
        recording.transitions[0].scene.blocks[0].position[1] = 0.123_456;
        let goal = Catalog::builtin().get(&"2_000".parse().unwrap()).unwrap();
        let json = serde_json::to_value(view(&recording, goal, |_| None).unwrap()).unwrap();
        assert_eq!(
            (&json["blueprint"], &json["end"], &json["weights_version"]),
            (&"2_000".into(), &"success".into(), &12.into())
        );
        assert_eq!(json["goal"].as_array().unwrap().len(), 2);
        // Two steps make three scenes; each step is worth 1 − 1 + 0.5 − 0.25 − 0.125.
        let scenes = json["scenes"].as_array().unwrap();
        let rewards: Vec<f64> = scenes.iter().map(|scene| scene["reward"].as_f64().unwrap()).collect();
        assert_eq!(rewards, [0.0, 0.125, 0.25]);
        assert_eq!(scenes[2]["reward_terms"]["connected"], 2.0);
        assert_eq!(scenes[2]["reward_terms"]["blocks"], -0.5);
        // Nothing is connected as in the goal, so the goal's lowest block determines its frame.
        let scene = &recording.transitions[0].scene;
        let frame = goal_frame(goal, scene);
        let placement = goal.placements().iter().min_by_key(|p| p.center_half_units[2]).unwrap();
        let turn = UnitQuaternion::new_normalize(Quaternion::from([frame[3], frame[4], frame[5], frame[6]]));
        let at = turn * placement.position_m() + Vector3::new(frame[0], frame[1], frame[2]);
        assert!((at - Vector3::from(scene.blocks[placement.block.get()].position)).norm() < 1e-3, "{at}");
        assert_eq!(json["links"].as_array().unwrap().len(), goal.links().len());
        assert_eq!([&json["names"][0], &json["names"][15]], ["cube 1", "slab 2"]);
        assert_eq!(scenes[0]["held"], serde_json::json!([4, null]));
        let y = scenes[0]["blocks"][0][1].as_f64().unwrap();
        assert!((y - 0.1235).abs() < 1e-6, "{y}");
    }
}

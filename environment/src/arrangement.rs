//! Arrangements of blocks from outside, such as a robot's own, and what makes one legal.

use std::fmt;

use blueprints::{BlockIdx, Inventory, N_BLOCKS};
use nalgebra::{Isometry3, Vector3};
use proto::{Joint, Pose};
use serde::{Deserialize, Serialize};

use crate::config::MagnetConfig;
use crate::connections::relative_along;
use crate::convert::from_pose;
use crate::magnets::{Frame, MagnetTable};
use crate::reset::Layout;

/// Maximum depth of an overlap with another block and with the ground, m. Blocks that are driven into each other at full
/// speed overlap by 5.5 cm for a moment, and with the ground by 7.8 cm.
const MAX_OVERLAP_M: f32 = 0.08;
const MAX_DEPTH_M: f32 = 0.1;
/// Maximum distance between two connected magnets, m, and maximum angle of their blocks, degrees: the largest ones at
/// which a world can be set to connect blocks.
const MAX_GAP_M: f32 = 0.045;
const MAX_ANGLE_DEG: f32 = 40.0;
/// Maximum deviation of a quaternion's length from 1.
const MAX_STRETCH: f32 = 0.01;

/// By how much at a time a block is raised to be clear of others, m, and how often at most: above any structure. Blocks
/// that touch overlap by less than `TOUCH_M`.
const RAISE_M: f32 = 0.01;
const MAX_RAISES: usize = 1000;
const TOUCH_M: f32 = 0.002;

/// Distance from the origin at which a block counts as lost and the episode as `Diverged`, m. It exceeds the distance
/// that a gripper can carry a block along one axis in an episode (3 m/s for 10 s). Episodes in which the agent flies off
/// with its blocks must stay in the data, or it never learns not to.
pub(crate) const RUNAWAY_M: f32 = 40.0;

/// Where blocks lie at rest, and which of them are connected.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Arrangement {
    /// Pose of each block.
    pub poses: [Pose; N_BLOCKS],
    /// Pairs of connected blocks, in any order.
    pub connections: Vec<(BlockIdx, BlockIdx)>,
}

/// What makes an arrangement illegal.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ArrangementError(String);

impl Arrangement {
    /// Returns the layout, with the connections as the magnets make them.
    ///
    /// # Errors
    /// Returns the first reason why no world can look like this.
    pub(crate) fn layout(&self) -> Result<Layout, ArrangementError> {
        for (block, pose) in BlockIdx::all().zip(&self.poses) {
            check_pose(block.get(), pose)?;
        }
        let poses = self.poses.each_ref().map(from_pose);
        let boxes = BlockIdx::array(|block| Solid::new(block, &poses[block.get()]));
        for a in BlockIdx::all() {
            let depth_m = boxes[a.get()].shadow(&Vector3::z()) - poses[a.get()].translation.z;
            if depth_m > MAX_DEPTH_M {
                return illegal(format_args!(
                    "block {} is {depth_m} m deep in the ground: expected at most {MAX_DEPTH_M}",
                    a.get()
                ));
            }
            for b in BlockIdx::all().skip(a.get() + 1) {
                let depth_m = boxes[a.get()].overlap(&boxes[b.get()]);
                if depth_m > MAX_OVERLAP_M {
                    let [a, b] = [a, b].map(BlockIdx::get);
                    return illegal(format_args!(
                        "blocks {a} and {b} overlap by {depth_m} m: expected at most {MAX_OVERLAP_M}"
                    ));
                }
            }
        }
        let joints = self.joints(&poses)?;
        Ok(Layout { poses, joints })
    }

    fn joints(&self, poses: &[Isometry3<f32>; N_BLOCKS]) -> Result<Vec<Joint>, ArrangementError> {
        let table = MagnetTable::new(Inventory::standard());
        let limits = MagnetConfig { snap_gap_m: MAX_GAP_M, snap_angle_deg: MAX_ANGLE_DEG, ..MagnetConfig::default() };
        let mut joints: Vec<Joint> = vec![];
        for &(one, other) in &self.connections {
            let (a, b) = (one.min(other), one.max(other));
            let (pose_a, pose_b) = (&poses[a.get()], &poses[b.get()]);
            let nearest = table.for_each_pair((a, &Frame::new(pose_a)), (b, &Frame::new(pose_b)), MAX_GAP_M, |_| {});
            let relative = nearest.filter(|_| a != b).and_then(|pair| pair.snap(pose_a, pose_b, &limits));
            let names = format!("blocks {} and {}", a.get(), b.get());
            let Some(relative) = relative else {
                return illegal(format_args!(
                    "{names} are connected: expected two blocks with opposite magnets within {MAX_GAP_M} m, \
                     turned by at most {MAX_ANGLE_DEG} degrees from where they fit"
                ));
            };
            let is_repeated = joints.iter().any(|joint| (joint.a, joint.b) == (a, b));
            let along = relative_along(joints.iter().copied(), a, b);
            if is_repeated || along.is_some_and(|along| along != relative) {
                return illegal(format_args!(
                    "the connection of {names} repeats or contradicts the connections before it"
                ));
            }
            joints.push(Joint { a, b, relative });
        }
        joints.sort_unstable();
        Ok(joints)
    }
}

/// Returns the pose of a block, raised until it is clear of the ground and of the others.
pub(crate) fn raised(poses: &[Isometry3<f32>; N_BLOCKS], block: BlockIdx) -> Isometry3<f32> {
    let mut pose = poses[block.get()];
    for _ in 0..MAX_RAISES {
        let own = Solid::new(block, &pose);
        let others = BlockIdx::all().filter(|&other| other != block);
        let mut others = others.map(|other| Solid::new(other, &poses[other.get()]));
        let is_free = others.all(|other| own.overlap(&other) <= TOUCH_M);
        if is_free && own.shadow(&Vector3::z()) <= pose.translation.z + TOUCH_M {
            break;
        }
        pose.translation.z += RAISE_M;
    }
    pose
}

fn check_pose(block: usize, &Pose { position, orientation }: &Pose) -> Result<(), ArrangementError> {
    // A NaN fails both comparisons.
    let is_near = Vector3::from(position).norm() <= RUNAWAY_M;
    let is_unit = (nalgebra::Vector4::from(orientation).norm() - 1.0).abs() <= MAX_STRETCH;
    match (is_near, is_unit) {
        (false, _) => illegal(format_args!(
            "block {block} is at {position:?}: expected three numbers within {RUNAWAY_M} m of the origin"
        )),
        (_, false) => illegal(format_args!(
            "block {block} has the orientation {orientation:?}: expected a unit quaternion x, y, z, w"
        )),
        (true, true) => Ok(()),
    }
}

fn illegal<T>(why: fmt::Arguments<'_>) -> Result<T, ArrangementError> {
    Err(ArrangementError(why.to_string()))
}

/// A block as a box.
struct Solid {
    center: Vector3<f32>,
    axes: [Vector3<f32>; 3],
    half_extents: Vector3<f32>,
}

impl Solid {
    fn new(block: BlockIdx, pose: &Isometry3<f32>) -> Self {
        let half_extents = Inventory::standard().half_extents_m(block).into();
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| pose.rotation * axis);
        Self { center: pose.translation.vector, axes, half_extents }
    }

    /// Returns half of the length that the box covers along a direction, m.
    fn shadow(&self, direction: &Vector3<f32>) -> f32 {
        self.axes.iter().zip(&self.half_extents).map(|(axis, half)| axis.dot(direction).abs() * half).sum()
    }

    /// Returns how far one of the two would have to move to be clear of the other, m; negative if they do not overlap.
    fn overlap(&self, other: &Self) -> f32 {
        let edges = self.axes.iter().flat_map(|a| other.axes.iter().map(move |b| a.cross(b)));
        // Of parallel edges, the faces tell all.
        let edges = edges.filter_map(|axis| axis.try_normalize(1e-3));
        let between = other.center - self.center;
        let depth = |axis: Vector3<f32>| self.shadow(&axis) + other.shadow(&axis) - between.dot(&axis).abs();
        let axes = self.axes.into_iter().chain(other.axes).chain(edges);
        axes.map(depth).fold(f32::INFINITY, f32::min)
    }
}

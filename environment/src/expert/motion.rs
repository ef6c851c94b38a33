//! How a gripper moves its load: straight to a pose, or over obstacles.

use blueprints::BlockIdx;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use proto::Move;

use super::view::View;
use crate::config::EnvironmentConfig;
use crate::world::CONTROL_DT_S;

/// Minimum gap to other blocks on the way, m.
const MARGIN_M: f32 = 0.022;
/// Poses sampled per control step of a predicted path.
const SAMPLES_PER_STEP: usize = 3;
/// Maximum number of predicted steps.
const MAX_STEPS: usize = 9;
/// Detours: heights above the target, tried in this order, m.
const DETOURS_M: [f32; 9] = [0.0, 0.08, 0.16, 0.24, 0.34, 0.46, 0.6, 0.8, 1.1];

/// Height above its target at which a block is carried while far from it, m; clears other blocks.
const CRUISE_M: f32 = 0.2;
/// Horizontal distance from the target within which a block goes straight to it, m. Farther out, the block stays higher
/// by the excess distance.
const FUNNEL_M: f32 = 0.1;

/// Climb up to which a block also moves sideways at full speed, m. Over the next `CLIMB_M`, the sideways speed falls to
/// 0.
const FREE_CLIMB_M: f32 = 0.1;
const CLIMB_M: f32 = 0.3;

/// Maximum height of a load that rises because no path is free, m.
const CEILING_M: f32 = 1.6;

/// Limits of the grippers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    pub(super) max_speed_mps: f32,
    pub(super) max_turn_radps: f32,
}

/// Motion of a held block over one step, world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Twist {
    pub(super) linear: Vector3<f32>,
    pub(super) angular: Vector3<f32>,
}

/// All blocks of a carried component, relative to the gripped block.
pub(super) struct Load {
    pub(super) gripped: BlockIdx,
    boxes: Vec<(BlockIdx, Isometry3<f32>)>,
}

impl Limits {
    pub(super) fn new(config: &EnvironmentConfig) -> Self {
        Self { max_speed_mps: config.max_speed_mps, max_turn_radps: config.max_turn_radps }
    }

    /// Returns the motion that reaches `to` from `from` in one step, or approaches it as fast as the gripper can.
    ///
    /// The world clips each component in the block's frame, which would bend the path. Here, all components shrink
    /// together.
    pub(super) fn toward(&self, from: &Isometry3<f32>, to: &Isometry3<f32>) -> Twist {
        let linear = (to.translation.vector - from.translation.vector) / CONTROL_DT_S;
        let angular = (to.rotation * from.rotation.inverse()).scaled_axis() / CONTROL_DT_S;
        self.clipped(&from.rotation, Twist { linear, angular })
    }

    pub(super) fn clipped(&self, frame: &UnitQuaternion<f32>, twist: Twist) -> Twist {
        let shrink = |v: Vector3<f32>, most: f32| {
            let largest = frame.inverse_transform_vector(&v).amax();
            if largest > most { v * (most / largest) } else { v }
        };
        Twist { linear: shrink(twist.linear, self.max_speed_mps), angular: shrink(twist.angular, self.max_turn_radps) }
    }

    /// Returns the motion as an action entry: in the block's frame, in fractions of the limits.
    pub(super) fn entry(&self, frame: &UnitQuaternion<f32>, twist: Twist) -> Move {
        let linear = frame.inverse_transform_vector(&twist.linear) / self.max_speed_mps;
        let angular = frame.inverse_transform_vector(&twist.angular) / self.max_turn_radps;
        [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z].map(|x| x.clamp(-1.0, 1.0))
    }

    /// Returns the motion along an arch to `to`: far from it, a block first rises and is carried above other blocks.
    pub(super) fn arch(&self, from: &Isometry3<f32>, to: &Isometry3<f32>) -> Twist {
        let apart = (to.translation.vector - from.translation.vector).xy().norm();
        let mut via = *to;
        via.translation.z += (apart - FUNNEL_M).clamp(0.0, CRUISE_M);
        let climb = via.translation.z - from.translation.z;
        let share = (1.0 - (climb - FREE_CLIMB_M) / CLIMB_M).clamp(0.0, 1.0);
        let mut twist = self.toward(from, &via);
        twist.linear.x *= share;
        twist.linear.y *= share;
        twist.linear.z = (climb / CONTROL_DT_S).clamp(-self.max_speed_mps, self.max_speed_mps);
        twist.angular *= share;
        self.clipped(&from.rotation, twist)
    }
}

impl Load {
    /// Creates a load of all blocks that are connected to `gripped`.
    pub(super) fn new(view: &View, gripped: BlockIdx) -> Self {
        let inverse = view.pose(gripped).inverse();
        let boxes = BlockIdx::all()
            .filter(|&block| view.together(block, gripped))
            .map(|block| (block, inverse * view.pose(block)))
            .collect();
        Self { gripped, boxes }
    }

    /// Moves the gripped block to `target`: along an arch if nothing is in the way, else straight to it or to a point
    /// above it, else up.
    ///
    /// The arch is a smooth function of the poses of block and target, which a policy can imitate; the shortest free
    /// path is not.
    pub(super) fn go(&self, view: &View, limits: &Limits, target: &Isometry3<f32>) -> Twist {
        let from = view.pose(self.gripped);
        if self.is_free(view, from, |at| limits.arch(at, target)) {
            return limits.arch(from, target);
        }
        for detour in DETOURS_M {
            let mut via = *target;
            via.translation.z += detour;
            if self.is_free(view, from, |at| limits.toward(at, &via)) {
                return limits.toward(from, &via);
            }
        }
        // Go up without turning, because the start may be narrow.
        let mut via = *from;
        via.translation.z = (via.translation.z + limits.max_speed_mps * CONTROL_DT_S).min(CEILING_M);
        limits.toward(from, &via)
    }

    /// Returns whether moving from `from` according to `way` touches nothing.
    pub(super) fn is_free(&self, view: &View, from: &Isometry3<f32>, way: impl Fn(&Isometry3<f32>) -> Twist) -> bool {
        let mut at = *from;
        for step in 0..MAX_STEPS {
            let twist = way(&at);
            if twist.linear.norm() < 1e-3 && twist.angular.norm() < 1e-2 {
                break;
            }
            for sample in 1..=SAMPLES_PER_STEP {
                let pose = advanced(&at, twist, sample as f32 / SAMPLES_PER_STEP as f32);
                // Blocks that are already close may stay close for a moment.
                let margin = if step == 0 { MARGIN_M * sample as f32 / SAMPLES_PER_STEP as f32 } else { MARGIN_M };
                if self.hits(view, &pose, margin) {
                    return false;
                }
            }
            at = advanced(&at, twist, 1.0);
        }
        true
    }

    /// Returns whether the load at `pose` comes within `margin` meters of another block or goes into the ground.
    pub(super) fn hits(&self, view: &View, pose: &Isometry3<f32>, margin: f32) -> bool {
        self.boxes.iter().any(|(block, relative)| {
            let at = pose * relative;
            let half = &view.half_extents[block.get()];
            lowest(&at, half) < -0.01
                || BlockIdx::all().any(|other| {
                    self.boxes.iter().all(|&(block, _)| block != other) && gap((&at, half), view.solid(other)) < margin
                })
        })
    }

    /// Returns the height of the load's lowest corner at `pose`, m.
    pub(super) fn lowest_m(&self, view: &View, pose: &Isometry3<f32>) -> f32 {
        let low = |(block, relative): &(BlockIdx, Isometry3<f32>)| {
            lowest(&(pose * relative), &view.half_extents[block.get()])
        };
        self.boxes.iter().map(low).fold(f32::INFINITY, f32::min)
    }

    /// Returns an upper bound on the distance of the load's corners from the center of the gripped block, m.
    pub(super) fn radius_m(&self, view: &View) -> f32 {
        let far = |(block, relative): &(BlockIdx, Isometry3<f32>)| {
            relative.translation.vector.norm() + view.half_extents[block.get()].norm()
        };
        self.boxes.iter().map(far).fold(0.0, f32::max)
    }

    /// Returns whether the load at `pose` is at least `margin` meters from all of `boxes`.
    pub(super) fn is_apart(
        &self,
        view: &View,
        pose: &Isometry3<f32>,
        boxes: &[(Isometry3<f32>, Vector3<f32>)],
        margin: f32,
    ) -> bool {
        self.boxes.iter().all(|(block, relative)| {
            let at = pose * relative;
            let half = &view.half_extents[block.get()];
            boxes.iter().all(|(other, other_half)| gap((&at, half), (other, other_half)) >= margin)
        })
    }
}

/// Returns the pose after `fraction` of a step.
fn advanced(from: &Isometry3<f32>, twist: Twist, fraction: f32) -> Isometry3<f32> {
    let dt = CONTROL_DT_S * fraction;
    let turn = UnitQuaternion::from_scaled_axis(twist.angular * dt);
    Isometry3::from_parts(Translation3::from(from.translation.vector + twist.linear * dt), turn * from.rotation)
}

/// Returns the height of a box's lowest corner, m.
pub(super) fn lowest(pose: &Isometry3<f32>, half: &Vector3<f32>) -> f32 {
    let down = pose.rotation.inverse_transform_vector(&Vector3::z());
    pose.translation.z - down.abs().dot(half)
}

/// Returns a lower bound on the distance between two boxes in meters; negative if they overlap or almost overlap.
///
/// Separating-axis test with only the six face normals, which underestimates the distance between edges.
pub(super) fn gap(a: (&Isometry3<f32>, &Vector3<f32>), b: (&Isometry3<f32>, &Vector3<f32>)) -> f32 {
    let between = b.0.translation.vector - a.0.translation.vector;
    let apart = between.norm() - a.1.norm() - b.1.norm();
    if apart > 0.1 {
        return apart;
    }
    let (rotation_a, rotation_b) = (a.0.rotation.to_rotation_matrix(), b.0.rotation.to_rotation_matrix());
    let relative = rotation_a.matrix().tr_mul(rotation_b.matrix());
    let (in_a, in_b) = (rotation_a.matrix().tr_mul(&between), rotation_b.matrix().tr_mul(&between));
    let mut largest = f32::NEG_INFINITY;
    for k in 0..3 {
        let shadow_b: f32 = (0..3).map(|j| relative[(k, j)].abs() * b.1[j]).sum();
        let shadow_a: f32 = (0..3).map(|j| relative[(j, k)].abs() * a.1[j]).sum();
        largest = largest.max(in_a[k].abs() - a.1[k] - shadow_b).max(in_b[k].abs() - b.1[k] - shadow_a);
    }
    largest
}

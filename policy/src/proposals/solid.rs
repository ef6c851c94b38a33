//! Blocks as boxes: how near they are, and which ones stand in the way.

use blueprints::{BlockIdx, Inventory};
use nalgebra::Vector3;

use crate::geometry::Frame;

/// What rounding may add to a depth, m.
const EDGE_M: f32 = 1e-3;

/// A block in the world.
#[derive(Clone, Copy)]
pub(super) struct Solid {
    pub(super) frame: Frame,
    half_extents_m: Vector3<f32>,
}

impl Solid {
    pub(super) fn new(block: BlockIdx, frame: Frame) -> Self {
        Self { frame, half_extents_m: Inventory::standard().half_extents_m(block).into() }
    }

    /// Returns the largest distance of the two along a face normal of either, m: negative if they overlap, and never
    /// more than their true distance.
    pub(super) fn gap(&self, other: &Self) -> f32 {
        let (own, others) = (&self.frame, &other.frame);
        let between = others.position - own.position;
        let along = |frame: &Frame, reach: Vector3<f32>| (frame.localize(&between).abs() - reach).max();
        along(own, self.reach(other)).max(along(others, other.reach(self)))
    }

    /// Returns the height of the lowest corner, m.
    pub(super) fn lowest_m(&self) -> f32 {
        self.frame.position.z - self.frame.axes.row(2).abs().transpose().dot(&self.half_extents_m)
    }

    /// Returns half the size of the smallest box with the axes of this one that both fit into, if they touch, m.
    fn reach(&self, other: &Self) -> Vector3<f32> {
        self.half_extents_m + self.frame.axes.tr_mul(&other.frame.axes).abs() * other.half_extents_m
    }

    /// Whether a `mover`, however it is turned, may come within `margin_m` on the straight way from `a` to `b`.
    pub(super) fn may_meet(&self, mover: &Self, margin_m: f32, a: &Vector3<f32>, b: &Vector3<f32>) -> bool {
        // The corners of a margin are √3 times as far out as its faces.
        let radii = self.half_extents_m.norm() + mover.half_extents_m.norm() + 2.0 * margin_m;
        let (way, to) = (b - a, self.frame.position - a);
        let part = (way.dot(&to) / way.norm_squared().max(1e-12)).clamp(0.0, 1.0);
        (to - way * part).norm_squared() < radii * radii
    }

    /// Returns the space around this block that the center of a `mover`, which does not turn, must not enter.
    pub(super) fn closed_to(&self, mover: &Self, margin_m: f32) -> Closed {
        Closed { frame: self.frame, reach_m: self.reach(mover).add_scalar(margin_m) }
    }
}

/// A box that a point must not enter.
pub(super) struct Closed {
    frame: Frame,
    reach_m: Vector3<f32>,
}

impl Closed {
    /// Whether the straight way from `a` to `b` enters the box. If one of them is inside, the box counts only as far as
    /// that: the point leaves it, or goes to it, but no deeper.
    pub(super) fn is_entered(&self, a: &Vector3<f32>, b: &Vector3<f32>) -> bool {
        let [a, b] = [a, b].map(|end| self.frame.localize(&(end - self.frame.position)));
        let outside = |end: &Vector3<f32>| (end.abs() - self.reach_m).max();
        let least = outside(&a).min(outside(&b));
        let reach = if least < 0.0 { self.reach_m.add_scalar(least - EDGE_M) } else { self.reach_m };
        if reach.min() <= 0.0 {
            return false;
        }
        // The parts of the way between the two planes of each axis have a common part.
        let (mut enter, mut leave) = (0.0_f32, 1.0_f32);
        for k in 0..3 {
            let step = b[k] - a[k];
            if step.abs() < 1e-6 {
                if a[k].abs() >= reach[k] {
                    return false;
                }
                continue;
            }
            let s = (-reach[k] - a[k]) / step;
            let t = (reach[k] - a[k]) / step;
            enter = enter.max(s.min(t));
            leave = leave.min(s.max(t));
        }
        enter < leave
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    /// Block 10 has 4 × 1 × 1 units of 0.1 m, and block 0 is a cube.
    fn solid(block: u8, at: [f32; 3], yaw: f32) -> Solid {
        let axes = *Rotation3::from_axis_angle(&Vector3::z_axis(), yaw).matrix();
        Solid::new(BlockIdx::try_from(block).unwrap(), Frame { position: at.into(), axes })
    }

    #[test]
    fn gaps_are_those_of_the_faces() {
        let bar = solid(10, [0.0, 0.0, 0.0], 0.0);
        assert!((bar.gap(&solid(0, [0.0, 0.3, 0.0], 0.0)) - 0.2).abs() < 1e-6);
        assert!((bar.gap(&solid(0, [0.24, 0.0, 0.0], 0.0)) + 0.01).abs() < 1e-6);
        // Turned by an eighth, the cube reaches √2 times as far.
        let turned = bar.gap(&solid(0, [0.0, 0.3, 0.0], std::f32::consts::FRAC_PI_4));
        assert!((turned - (0.25 - 0.05 * 2.0_f32.sqrt())).abs() < 1e-6, "{turned}");
        // The gap does not depend on the order.
        let other = solid(11, [0.2, 0.5, 0.1], 0.7);
        assert!((bar.gap(&other) - other.gap(&bar)).abs() < 1e-6);
    }

    #[test]
    fn a_bar_on_its_end_reaches_half_its_length_down() {
        let axes = *Rotation3::from_axis_angle(&Vector3::y_axis(), std::f32::consts::FRAC_PI_2).matrix();
        let bar = |axes| Solid::new(BlockIdx::try_from(10).unwrap(), Frame { position: Vector3::z() * 0.3, axes });
        assert!((bar(axes).lowest_m() - 0.1).abs() < 1e-6);
        assert!((bar(nalgebra::Matrix3::identity()).lowest_m() - 0.25).abs() < 1e-6);
    }

    #[test]
    fn a_way_is_closed_for_the_whole_block_that_moves() {
        let cube = solid(0, [0.0, 0.0, 0.0], 0.0);
        let from = Vector3::new(-0.5, 0.16, 0.0);
        let to = Vector3::new(0.5, 0.16, 0.0);
        let closed = |mover: &Solid| cube.closed_to(mover, 0.02).is_entered(&from, &to);
        // 0.16 m off: the bar passes lengthwise (0.05 + 0.05 + 0.02 m), but not broadside (0.05 + 0.2 + 0.02 m).
        assert!(!closed(&solid(10, [-0.5, 0.16, 0.0], 0.0)));
        assert!(closed(&solid(10, [-0.5, 0.16, 0.0], std::f32::consts::FRAC_PI_2)));
    }

    #[test]
    fn what_is_near_already_closes_the_way_only_deeper_in() {
        let cube = solid(0, [0.0, 0.0, 0.0], 0.0);
        let space = cube.closed_to(&solid(1, [0.0; 3], 0.0), 0.02);
        let near = Vector3::new(-0.11, 0.0, 0.0);
        assert!(!space.is_entered(&near, &Vector3::new(-0.5, 0.0, 0.0)));
        assert!(!space.is_entered(&near, &Vector3::new(-0.11, 0.3, 0.0)));
        assert!(space.is_entered(&near, &Vector3::new(0.5, 0.0, 0.0)));
    }
}

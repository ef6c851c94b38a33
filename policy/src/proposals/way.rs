//! Rigid motions of a block in its own frame.

use nalgebra::{Rotation3, Vector3};
use proto::Move;

use crate::geometry::Frame;

/// Reach of one step at full speed, m: 3 m/s for 0.1 s.
pub(super) const STEP_M: f32 = 0.3;
/// Reach of one step at full speed, rad: 2π rad/s for 0.1 s.
pub(super) const STEP_RAD: f32 = 0.2 * std::f32::consts::PI;

/// A rigid motion of a block, in its own frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Way {
    /// m
    pub(super) shift: Vector3<f32>,
    /// Axis times angle, rad.
    pub(super) turn: Vector3<f32>,
}

impl Way {
    /// Returns this part of the motion.
    pub(super) fn part(self, share: f32) -> Self {
        Self { shift: self.shift * share, turn: self.turn * share }
    }

    /// Returns where the motion leads.
    pub(super) fn moved(&self, own: &Frame) -> Frame {
        let axes = own.axes * Rotation3::new(self.turn).matrix();
        Frame { position: own.position + own.axes * self.shift, axes }
    }

    /// Returns the number of steps that the motion takes at full speed.
    pub(super) fn n_steps(&self) -> f32 {
        (self.shift.amax() / STEP_M).max(self.turn.amax() / STEP_RAD)
    }

    /// Returns the distance from the line through the place along `normal`, m, and the angle to turn, rad.
    pub(super) fn off_axis(&self, normal: &Vector3<f32>) -> (f32, f32) {
        ((self.shift - normal * normal.dot(&self.shift)).norm(), self.turn.norm())
    }

    /// Returns the velocities of one step.
    pub(super) fn to_move(self) -> Move {
        let n_steps = self.n_steps().max(1.0);
        let (linear, angular) = (self.shift / (STEP_M * n_steps), self.turn / (STEP_RAD * n_steps));
        [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
    }
}

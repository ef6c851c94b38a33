//! The rectangle that a block covers on the ground.

use blueprints::{BlockIdx, Inventory};
use nalgebra::{UnitQuaternion, Vector2, Vector3};

/// A block at rest on one of its faces, seen from above.
#[derive(Clone, Debug)]
pub(crate) struct Footprint {
    /// Center in meters.
    pub(crate) center: [f32; 2],
    /// Half the height in meters.
    pub(crate) half_height: f32,
    /// The two half sides as vectors, m.
    sides: [Vector2<f32>; 2],
}

impl Footprint {
    /// Returns the footprint of a block with one axis upright; `center` is in meters.
    pub(crate) fn new(block: BlockIdx, rotation: &UnitQuaternion<f32>, center: [f32; 2]) -> Self {
        let half = Inventory::standard().half_extents_m(block);
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| rotation * axis);
        let upright = (0..3).fold(0, |best, k| if axes[k].z.abs() > axes[best].z.abs() { k } else { best });
        let side = |k: usize| axes[k].xy() * half[k];
        Self { center, half_height: half[upright], sides: [side((upright + 1) % 3), side((upright + 2) % 3)] }
    }

    /// Returns a lower bound on the distance between the two in meters; negative or zero if they may overlap.
    pub(crate) fn gap(&self, other: &Self) -> f32 {
        let between = Vector2::from(other.center) - Vector2::from(self.center);
        let shadow = |of: &Self, axis: &Vector2<f32>| of.sides.iter().map(|s| s.dot(axis).abs()).sum::<f32>();
        self.sides
            .iter()
            .chain(&other.sides)
            .map(|side| {
                let axis = side.normalize();
                between.dot(&axis).abs() - shadow(self, &axis) - shadow(other, &axis)
            })
            .fold(f32::NEG_INFINITY, f32::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gap_of_two_cubes_is_that_of_their_faces() {
        let cube = BlockIdx::try_from(0).unwrap();
        let at = |x: f32, yaw: f32| {
            Footprint::new(cube, &UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw), [x, 0.0])
        };
        // The centers are 0.2 apart, and each cube reaches 0.05; turned by 45°, it reaches 0.0707.
        assert!((at(0.0, 0.0).gap(&at(0.2, 0.0)) - 0.1).abs() < 1e-6);
        assert!((at(0.0, 0.0).gap(&at(0.2, std::f32::consts::FRAC_PI_4)) - 0.079289).abs() < 1e-5);
        assert!(at(0.0, 0.0).gap(&at(0.09, 0.0)) < 0.0);
    }
}

//! A partial layout.

use blueprints::{BlockIdx, N_BLOCKS};
use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use proto::Joint;
use rand::RngExt;
use rand::rngs::ChaCha8Rng;

use super::footprint::Footprint;

/// Minimum gap between scattered blocks, m; none attract.
const CLEARANCE_M: f32 = 0.05;

/// The blocks that have a place.
#[derive(Clone, Default)]
pub(super) struct Draft {
    pub(super) poses: [Option<Isometry3<f32>>; N_BLOCKS],
    pub(super) footprints: Vec<Footprint>,
    pub(super) joints: Vec<Joint>,
}

impl Draft {
    /// Puts a block on the ground with its center at `xy` in meters; false if there is no room.
    pub(super) fn put(&mut self, block: BlockIdx, rotation: UnitQuaternion<f32>, xy: [f32; 2]) -> bool {
        let footprint = Footprint::new(block, &rotation, xy);
        let is_free = self.footprints.iter().all(|other| footprint.gap(other) >= CLEARANCE_M);
        if is_free {
            let translation = Translation3::new(xy[0], xy[1], footprint.half_height);
            self.poses[block.get()] = Some(Isometry3::from_parts(translation, rotation));
            self.footprints.push(footprint);
        }
        is_free
    }
}

/// Returns a number in ±`half_width`.
pub(super) fn symmetric(rng: &mut ChaCha8Rng, half_width: f32) -> f32 {
    half_width * (2.0 * rng.random::<f32>() - 1.0)
}

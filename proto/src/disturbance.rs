//! What somebody outside does to a block in the middle of an episode.

use blueprints::BlockIdx;

/// Largest displacement along an axis, m.
pub const MAX_DISPLACEMENT_M: f32 = 2.0;

/// Largest change of velocity along an axis, m/s.
pub const MAX_PUSH_MPS: f32 = 5.0;

/// A block that is moved, pushed, or both, in the world frame, while the action of a step begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disturbance {
    block: BlockIdx,
    displacement_m: [f32; 3],
    push_mps: [f32; 3],
}

/// Numbers that are no disturbance.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "moved by {displacement_m:?} m and pushed by {push_mps:?} m/s, but the most along an axis is {MAX_DISPLACEMENT_M} m \
     and {MAX_PUSH_MPS} m/s, and one must not be 0"
)]
pub struct InvalidDisturbance {
    displacement_m: [f32; 3],
    push_mps: [f32; 3],
}

impl Disturbance {
    /// Moves a block by `displacement_m` and changes its velocity by `push_mps`.
    ///
    /// # Errors
    /// If both are zero, or one is beyond the limits.
    pub fn new(block: BlockIdx, displacement_m: [f32; 3], push_mps: [f32; 3]) -> Result<Self, InvalidDisturbance> {
        // A NaN fails the comparison.
        let is_within = |values: [f32; 3], most: f32| values.iter().all(|x| x.abs() <= most);
        let is_something = displacement_m != [0.0; 3] || push_mps != [0.0; 3];
        if is_something && is_within(displacement_m, MAX_DISPLACEMENT_M) && is_within(push_mps, MAX_PUSH_MPS) {
            Ok(Self { block, displacement_m, push_mps })
        } else {
            Err(InvalidDisturbance { displacement_m, push_mps })
        }
    }

    /// Returns the block.
    pub fn block(&self) -> BlockIdx {
        self.block
    }

    /// Returns how far the block is moved, m.
    pub fn displacement_m(&self) -> [f32; 3] {
        self.displacement_m
    }

    /// Returns by how much its velocity changes, m/s.
    pub fn push_mps(&self) -> [f32; 3] {
        self.push_mps
    }
}

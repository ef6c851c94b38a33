//! The state of a world after a step: plain data for features, rewards, replays, and videos.

use blueprints::pieces::pieces;
use blueprints::{BlockIdx, Blueprint, N_BLOCKS, RelativePlacement};
use serde::{Deserialize, Serialize};

/// Number of grippers (paper: 2; the single-gripper ablation leaves the second one absent).
pub const N_GRIPPERS: usize = 2;

/// Position and orientation in the world frame, z up.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Center in meters.
    pub position: [f32; 3],
    /// Unit quaternion, order x, y, z, w.
    pub orientation: [f32; 4],
}

/// Two blocks held together by their magnets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Joint {
    /// The lower block index.
    pub a: BlockIdx,
    /// The higher block index.
    pub b: BlockIdx,
    /// Nominal pose of `b` relative to `a`; equal to that of a [`blueprints::Link`] if the connection is correct.
    pub relative: RelativePlacement,
}

/// State of one gripper after a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gripper {
    /// Block held during the last step; `None` before the first step and during a delayed switch.
    pub held: Option<BlockIdx>,
    /// Orientation of the held block (or of the last one held), unit quaternion x, y, z, w.
    pub orientation: [f32; 4],
    /// Commanded linear velocity of the last step, world frame, m/s.
    pub linear_velocity: [f32; 3],
    /// Commanded angular velocity of the last step, world frame, rad/s.
    pub angular_velocity: [f32; 3],
}

impl Gripper {
    /// A gripper that has not held a block yet.
    pub const IDLE: Self =
        Self { held: None, orientation: [0.0, 0.0, 0.0, 1.0], linear_velocity: [0.0; 3], angular_velocity: [0.0; 3] };
}

/// A snapshot of a world.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Pose of each block.
    pub blocks: [Pose; N_BLOCKS],
    /// Speed of each block: |v| + |ω| × half the block's diagonal, m/s.
    pub speeds_mps: [f32; N_BLOCKS],
    /// Existing connections, sorted, at most one per block pair.
    pub joints: Vec<Joint>,
    /// Grippers; the second is `None` in single-gripper worlds.
    pub grippers: [Option<Gripper>; N_GRIPPERS],
    /// Number of contacts with a force above the threshold during the last step.
    pub n_heavy_contacts: u8,
}

impl Joint {
    /// Whether the goal, permuted by the episode's assignment, wants this connection.
    pub fn is_right(&self, goal: &Blueprint) -> bool {
        goal.link(self.a, self.b).is_some_and(|link| link.relative == self.relative)
    }
}

impl Scene {
    /// Returns blocks at rest in these poses, without connections, and grippers that have not held a block yet.
    pub fn at_rest(blocks: [Pose; N_BLOCKS]) -> Self {
        Self {
            blocks,
            speeds_mps: [0.0; N_BLOCKS],
            joints: Vec::new(),
            grippers: [Some(Gripper::IDLE); N_GRIPPERS],
            n_heavy_contacts: 0,
        }
    }

    /// Returns, for each block, the lowest block index in its component, where connections that `goal` requires join
    /// blocks into components. Blocks of one component have the same value.
    pub fn pieces(&self, goal: &Blueprint) -> [usize; N_BLOCKS] {
        self.components(|joint| joint.is_right(goal))
    }

    /// Returns the same for all connections, required or not: blocks of one component move together.
    pub fn bodies(&self) -> [usize; N_BLOCKS] {
        self.components(|_| true)
    }

    fn components(&self, counts: impl Fn(&Joint) -> bool) -> [usize; N_BLOCKS] {
        let joints = self.joints.iter().filter(|joint| counts(joint));
        let components = pieces(N_BLOCKS, joints.map(|joint| (joint.a.get(), joint.b.get())));
        components.try_into().expect("one for each block")
    }
}

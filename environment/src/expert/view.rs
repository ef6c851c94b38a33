//! What the expert reads from a scene: correct pieces, wrong connections, and poses.

use blueprints::assembly::Parts;
use blueprints::{BlockIdx, Blueprint, Inventory, N_BLOCKS};
use nalgebra::{Isometry3, Vector3};
use proto::{Joint, N_GRIPPERS, Scene};

use crate::convert::from_pose;

/// A scene in terms of a goal.
pub(super) struct View {
    pub(super) poses: [Isometry3<f32>; N_BLOCKS],
    pub(super) half_extents: [Vector3<f32>; N_BLOCKS],
    /// The blueprint part that each block plays.
    pub(super) part_of: [Option<usize>; N_BLOCKS],
    /// For each part, the parts joined to it by correct connections only.
    pieces: Vec<Parts>,
    /// Connections that the blueprint does not have.
    pub(super) wrong: Vec<Joint>,
    pub(super) joints: Vec<Joint>,
    pub(super) held: [Option<BlockIdx>; N_GRIPPERS],
    /// Lowest block index in each block's component, over all connections.
    bodies: [usize; N_BLOCKS],
}

impl View {
    /// Creates a view; `blocks` play the assembly's parts, in order.
    pub(super) fn new(scene: &Scene, blueprint: &Blueprint, blocks: &[BlockIdx]) -> Self {
        let poses = scene.blocks.each_ref().map(from_pose);
        let half_extents = BlockIdx::array(|block| Vector3::from(Inventory::standard().half_extents_m(block)));
        let mut part_of = [None; N_BLOCKS];
        for (part, block) in blocks.iter().enumerate() {
            part_of[block.get()] = Some(part);
        }
        let names = scene.pieces(blueprint);
        let piece_of = |block: &BlockIdx| {
            let is_joined = |part: &usize| names[blocks[*part].get()] == names[block.get()];
            (0..blocks.len()).filter(is_joined).fold(Parts::default(), Parts::with)
        };
        Self {
            poses,
            half_extents,
            part_of,
            pieces: blocks.iter().map(piece_of).collect(),
            wrong: scene.joints.iter().filter(|joint| !joint.is_right(blueprint)).copied().collect(),
            joints: scene.joints.clone(),
            held: scene.grippers.map(|gripper| gripper.and_then(|g| g.held)),
            bodies: scene.bodies(),
        }
    }

    /// Returns the parts joined to `part` by correct connections.
    pub(super) fn piece(&self, part: usize) -> Parts {
        self.pieces[part]
    }

    /// Returns all pieces, each once.
    pub(super) fn pieces(&self) -> impl Iterator<Item = Parts> + '_ {
        self.pieces.iter().enumerate().filter(|&(part, piece)| piece.iter().next() == Some(part)).map(|(_, &p)| p)
    }

    /// Returns whether any connections join the two blocks, directly or through others.
    pub(super) fn together(&self, a: BlockIdx, b: BlockIdx) -> bool {
        self.bodies[a.get()] == self.bodies[b.get()]
    }

    pub(super) fn pose(&self, block: BlockIdx) -> &Isometry3<f32> {
        &self.poses[block.get()]
    }

    /// Returns the block as a box: its pose and its half extents, m.
    pub(super) fn solid(&self, block: BlockIdx) -> (&Isometry3<f32>, &Vector3<f32>) {
        (self.pose(block), &self.half_extents[block.get()])
    }

    pub(super) fn is_held(&self, block: BlockIdx) -> bool {
        self.held.contains(&Some(block))
    }
}

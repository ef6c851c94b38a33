//! The geometry of blocks: colored faces.

use blueprints::{BlockIdx, Blueprint, Inventory, UNIT_M};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use proto::{N_GRIPPERS, Scene};

use super::image::Rgb;

/// Colors of the block types in inventory order, after Okabe and Ito's palette, but lighter. They differ in hue and,
/// for viewers who see fewer hues, in lightness; none is the red or blue of a magnet.
pub const TYPE_COLORS: [Rgb; 6] =
    [[250, 216, 92], [240, 154, 55], [62, 178, 138], [128, 196, 236], [206, 142, 190], [118, 130, 150]];

/// Frame colors of held blocks, by gripper.
pub const GRIPPER_COLORS: [Rgb; N_GRIPPERS] = [[214, 0, 110], [20, 20, 24]];

/// A block to draw.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    /// The block, which determines size and color.
    pub block: BlockIdx,
    /// Its center in meters and its orientation, world frame, z up.
    pub pose: Isometry3<f32>,
    /// Color of its sides, which then have no magnets, instead of its type's.
    pub shade: Option<Rgb>,
    /// Color of wide edges around each side, instead of thin dark ones.
    pub frame: Option<Rgb>,
}

/// A rectangular side of a block.
pub(super) struct Side {
    /// The corners in order: from one corner along the side's first axis, then its second.
    pub(super) corners: [Point3<f32>; 4],
    /// Outward unit normal, world frame.
    pub(super) normal: Vector3<f32>,
    /// Length along the first and second axis in unit cells; each cell has a magnet in its center.
    pub(super) cells: [f32; 2],
    /// Whether the magnets are positive.
    pub(super) is_positive: bool,
}

/// Returns the blocks of a blueprint in its own frame.
pub fn of_blueprint(blueprint: &Blueprint) -> Vec<Block> {
    let placed = blueprint.placements().iter().map(|at| {
        let pose = Isometry3::from_parts(at.position_m().into(), at.rotation.quaternion());
        Block { block: at.block, pose, shade: None, frame: None }
    });
    placed.collect()
}

/// Returns all blocks of a world; held blocks are framed in the gripper's color.
pub fn of_scene(scene: &Scene) -> Vec<Block> {
    let placed = BlockIdx::all().zip(&scene.blocks).map(|(block, at)| {
        let rotation = UnitQuaternion::new_normalize(at.orientation.into());
        let pose = Isometry3::from_parts(at.position.into(), rotation);
        Block { block, pose, shade: None, frame: holder(scene, block).map(|gripper| GRIPPER_COLORS[gripper]) }
    });
    placed.collect()
}

/// Returns the index of the gripper that holds a block.
pub(crate) fn holder(scene: &Scene, block: BlockIdx) -> Option<usize> {
    scene.grippers.iter().position(|gripper| gripper.is_some_and(|gripper| gripper.held == Some(block)))
}

/// Returns the corners of all blocks (m, world), for framing.
pub fn corners(blocks: &[Block]) -> Vec<Point3<f32>> {
    blocks.iter().flat_map(Block::corners).collect()
}

impl Block {
    /// Returns the color of the sides.
    pub(super) fn color(&self) -> Rgb {
        self.shade.unwrap_or(TYPE_COLORS[Inventory::standard().type_idx(self.block) % TYPE_COLORS.len()])
    }

    fn half_extents_m(&self) -> Vector3<f32> {
        Vector3::from(Inventory::standard().half_extents_m(self.block))
    }

    fn corners(&self) -> impl Iterator<Item = Point3<f32>> {
        let half = self.half_extents_m();
        let sign = move |k: usize, axis: usize| if k >> axis & 1 == 1 { half[axis] } else { -half[axis] };
        (0..8).map(move |k| self.pose * Point3::new(sign(k, 0), sign(k, 1), sign(k, 2)))
    }

    /// Returns the six sides: +x −x +y −y +z −z.
    pub(super) fn sides(&self) -> impl Iterator<Item = Side> {
        let half = self.half_extents_m();
        (0..6).map(move |k| {
            let axis = k / 2;
            let is_positive = k % 2 == 0;
            let (first, second) = ((axis + 1) % 3, (axis + 2) % 3);
            let mut normal = Vector3::zeros();
            normal[axis] = if is_positive { 1.0 } else { -1.0 };
            let corner = |along_first: f32, along_second: f32| {
                let mut at = normal * half[axis];
                at[first] = along_first * half[first];
                at[second] = along_second * half[second];
                self.pose * Point3::from(at)
            };
            Side {
                corners: [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)],
                normal: self.pose.rotation * normal,
                cells: [first, second].map(|axis| 2.0 * half[axis] / UNIT_M),
                is_positive,
            }
        })
    }
}

//! A structure on the ground, complete or partial.

use std::f32::consts::TAU;

use blueprints::pieces::pieces;
use blueprints::{BlockIdx, Blueprint, Inventory, Placement};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use proto::Joint;
use rand::RngExt;
use rand::rngs::ChaCha8Rng;
use rand::seq::SliceRandom;

use super::draft::{Draft, symmetric};
use super::footprint::Footprint;

/// Maximum offset of a structure from the origin in x and in y, m.
const MAX_OFFSET_M: f32 = 0.2;

/// Connects the blocks `kept` of `blueprint` near the origin, turned by a random yaw, with the lowest on the ground.
pub(super) fn stand(blueprint: &Blueprint, kept: &[BlockIdx], rng: &mut ChaCha8Rng) -> Draft {
    let placements: Vec<_> = blueprint.placements().iter().filter(|p| kept.contains(&p.block)).collect();
    let n = placements.len().max(1) as f32;
    let middle: Vector3<f32> = placements.iter().map(|p| p.position_m()).sum::<Vector3<f32>>() / n;
    let bottom = placements.iter().map(|p| bottom_half_units(p)).min().unwrap_or(0) as f32 * blueprints::UNIT_M / 2.0;
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), rng.random_range(0.0..TAU));
    let origin = Vector3::new(symmetric(rng, MAX_OFFSET_M), symmetric(rng, MAX_OFFSET_M), 0.0);
    let mut draft = Draft::default();
    for placement in placements {
        let from_middle = placement.position_m() - Vector3::new(middle.x, middle.y, bottom);
        let position = origin + yaw * from_middle;
        let rotation = yaw * placement.rotation.quaternion();
        draft.footprints.push(Footprint::new(placement.block, &rotation, [position.x, position.y]));
        draft.poses[placement.block.get()] = Some(Isometry3::from_parts(Translation3::from(position), rotation));
    }
    let kept_links = blueprint.links().iter().filter(|link| kept.contains(&link.a) && kept.contains(&link.b));
    draft.joints = kept_links.map(|link| Joint { a: link.a, b: link.b, relative: link.relative }).collect();
    draft
}

/// Returns the blocks that remain after `undone` are removed one by one. The rest stays connected and, where possible,
/// stands.
pub(super) fn remaining_after(blueprint: &Blueprint, undone: u8, rng: &mut ChaCha8Rng) -> Vec<BlockIdx> {
    let mut kept: Vec<_> = blueprint.placements().iter().map(|p| p.block).collect();
    for _ in 0..undone {
        let mut order = kept.clone();
        order.shuffle(rng);
        let without = |block: BlockIdx| kept.iter().copied().filter(|&b| b != block).collect::<Vec<_>>();
        let mut choices: Vec<_> = order.into_iter().map(without).filter(|rest| is_connected(blueprint, rest)).collect();
        let standing = choices.iter().position(|rest| stands(blueprint, rest));
        // A connected structure always has a block whose removal leaves it connected.
        kept = choices.swap_remove(standing.unwrap_or(0));
    }
    kept
}

fn is_connected(blueprint: &Blueprint, blocks: &[BlockIdx]) -> bool {
    let place = |block| blocks.iter().position(|&other| other == block);
    let links = blueprint.links().iter().filter_map(|link| Some((place(link.a)?, place(link.b)?)));
    pieces(blocks.len(), links).iter().all(|&piece| piece == 0)
}

/// Returns whether the center of mass is above the bounding rectangle of the lowest blocks.
///
/// The rectangle is slightly larger than the true support. A structure that falls over is a poor start, not an error.
fn stands(blueprint: &Blueprint, blocks: &[BlockIdx]) -> bool {
    let placements: Vec<_> = blueprint.placements().iter().filter(|p| blocks.contains(&p.block)).collect();
    let bottom = placements.iter().map(|p| bottom_half_units(p)).min();
    let volume = |p: &Placement| Inventory::standard().cells(p.block).iter().map(|&n| f32::from(n)).product::<f32>();
    let mass: f32 = placements.iter().map(|p| volume(p)).sum();
    (0..2).all(|axis| {
        let center = placements.iter().map(|p| volume(p) * p.center_half_units[axis] as f32).sum::<f32>() / mass;
        let lowest = placements.iter().filter(|p| Some(bottom_half_units(p)) == bottom);
        let edges = lowest.map(|p| {
            let half = p.size_cells()[axis];
            (p.center_half_units[axis] - half, p.center_half_units[axis] + half)
        });
        let (low, high) = edges.fold((i32::MAX, i32::MIN), |(low, high), (l, h)| (low.min(l), high.max(h)));
        low as f32 <= center && center <= high as f32
    })
}

fn bottom_half_units(placement: &Placement) -> i32 {
    placement.center_half_units[2] - placement.size_cells()[2]
}

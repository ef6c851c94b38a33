//! Initial states: poses and connections of the blocks, drawn from a seed.

mod draft;
mod footprint;
mod structure;

use std::f32::consts::{FRAC_PI_2, TAU};

use blueprints::{BlockIdx, Blueprint, Inventory, N_BLOCKS};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use proto::Joint;
use rand::RngExt;
use rand::rngs::ChaCha8Rng;
use rand::seq::SliceRandom;

use crate::env::ResetError;
use draft::{Draft, symmetric};
use structure::{remaining_after, stand};

/// Half width of the square around the origin in which blocks are scattered, m.
const ARENA_HALF_WIDTH_M: f32 = 0.8;
/// Maximum ratio of a scattered block's height to the shorter side of the face that it rests on.
const MAX_SLENDERNESS: f32 = 2.0;
/// Near-goal starts: maximum distance of a removed block's center from its target in x and in y, m. It grows by 2 % with
/// every attempt that finds no free ground.
const NEAR_GOAL_M: f32 = 0.15;
/// Near-goal starts: maximum rotation of a removed block from its target yaw, rad.
const YAW_NOISE_RAD: f32 = 0.3;

/// Attempts per block before the whole layout starts over, and layouts before giving up.
const N_TRIES: usize = 200;
const N_LAYOUTS: usize = 50;

/// Poses of the blocks at rest, and their connections.
#[derive(Clone, Debug)]
pub(crate) struct Layout {
    pub(crate) poses: [Isometry3<f32>; N_BLOCKS],
    pub(crate) joints: Vec<Joint>,
}

/// Returns an assignment that shuffles the blocks of each type among themselves, with all permutations equally likely.
///
/// A policy sees slot numbers. Shuffling identical blocks in every episode keeps it from relying on them.
pub fn sample_assignment(rng: &mut ChaCha8Rng) -> [BlockIdx; N_BLOCKS] {
    let inventory = Inventory::standard();
    let mut assignment = BlockIdx::array(|block| block);
    for block_type in inventory.types() {
        let slots = inventory.blocks_of_type(block_type.name);
        let mut players = slots.clone();
        players.shuffle(rng);
        for (slot, player) in slots.into_iter().zip(players) {
            assignment[slot.get()] = player;
        }
    }
    assignment
}

/// Scatters all blocks on the ground.
pub(crate) fn scattered(rng: &mut ChaCha8Rng) -> Result<Layout, ResetError> {
    lay_out(rng, |_| Some(Draft::default()))
}

/// Builds `blueprint` and scatters the other blocks.
pub(crate) fn prebuilt(blueprint: &Blueprint, rng: &mut ChaCha8Rng) -> Result<Layout, ResetError> {
    lay_out(rng, |rng| {
        let all: Vec<_> = blueprint.placements().iter().map(|p| p.block).collect();
        Some(stand(blueprint, &all, rng))
    })
}

/// Builds `blueprint` except for `undone` blocks, which lie near their targets, and scatters the other blocks.
pub(crate) fn near_goal(blueprint: &Blueprint, undone: u8, rng: &mut ChaCha8Rng) -> Result<Layout, ResetError> {
    let most = blueprint.n_blocks() - 1;
    if !(1..=most).contains(&usize::from(undone)) {
        let id = blueprint.id();
        return Err(ResetError::Unfit(format!(
            "a near-goal start of {id} cannot take off {undone} blocks; it must be 1 to {most}"
        )));
    }
    lay_out(rng, |rng| {
        let kept = remaining_after(blueprint, undone, rng);
        let mut draft = stand(blueprint, &kept, rng);
        for placement in blueprint.placements().iter().filter(|p| !kept.contains(&p.block)) {
            // The structure is already placed, and its frame follows from any of its blocks.
            let anchor = blueprint.placement(kept[0])?;
            let in_blueprint =
                |p: &blueprints::Placement| Isometry3::from_parts(p.position_m().into(), p.rotation.quaternion());
            let frame = draft.poses[anchor.block.get()]? * in_blueprint(anchor).inverse();
            put_beside(&mut draft, placement.block, &(frame * in_blueprint(placement)), rng)?;
        }
        Some(draft)
    })
}

/// Places a block on the ground near its target, slightly turned.
fn put_beside(draft: &mut Draft, block: BlockIdx, place: &Isometry3<f32>, rng: &mut ChaCha8Rng) -> Option<()> {
    let mut reach = NEAR_GOAL_M;
    for _ in 0..N_TRIES {
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), symmetric(rng, YAW_NOISE_RAD));
        let (x, y) = (place.translation.x + symmetric(rng, reach), place.translation.y + symmetric(rng, reach));
        if draft.put(block, yaw * place.rotation, [x, y]) {
            return Some(());
        }
        // The structure there may be wide, so look farther and farther away.
        reach *= 1.02;
    }
    None
}

/// Repeats `begin` and scatters the remaining blocks, until all have found room.
fn lay_out(rng: &mut ChaCha8Rng, begin: impl Fn(&mut ChaCha8Rng) -> Option<Draft>) -> Result<Layout, ResetError> {
    let mut homeless = BlockIdx::all().next().expect("there are blocks");
    for _ in 0..N_LAYOUTS {
        let Some(mut draft) = begin(rng) else { continue };
        // Large blocks first, because they would not find room between the small ones.
        let mut left: Vec<_> = BlockIdx::all().filter(|b| draft.poses[b.get()].is_none()).collect();
        left.reverse();
        match left.into_iter().find(|&block| !scatter(&mut draft, block, rng)) {
            Some(block) => homeless = block,
            None => {
                draft.joints.sort_unstable();
                let poses = draft.poses.map(|pose| pose.expect("every block has been placed"));
                return Ok(Layout { poses, joints: draft.joints });
            }
        }
    }
    Err(ResetError::NoRoom(homeless))
}

fn scatter(draft: &mut Draft, block: BlockIdx, rng: &mut ChaCha8Rng) -> bool {
    (0..N_TRIES).any(|_| {
        let rotation = random_rotation(block, rng);
        let xy = [symmetric(rng, ARENA_HALF_WIDTH_M), symmetric(rng, ARENA_HALF_WIDTH_M)];
        draft.put(block, rotation, xy)
    })
}

/// Returns a random yaw on a random face on which the block stands firmly.
fn random_rotation(block: BlockIdx, rng: &mut ChaCha8Rng) -> UnitQuaternion<f32> {
    let half = Inventory::standard().half_extents_m(block);
    let stands = |axis: usize| {
        let (side, other) = (half[(axis + 1) % 3], half[(axis + 2) % 3]);
        // A little slack, because 2 × 0.05 may not equal 0.1.
        half[axis] <= side.min(other) * MAX_SLENDERNESS * 1.001
    };
    let axes: Vec<_> = (0..3).filter(|&axis| stands(axis)).collect();
    let axis = axes[rng.random_range(0..axes.len())];
    let flip = if rng.random::<bool>() { FRAC_PI_2 } else { -FRAC_PI_2 };
    // The rotation that turns the block's axis up or down.
    let face = match axis {
        0 => UnitQuaternion::from_axis_angle(&Vector3::y_axis(), flip),
        1 => UnitQuaternion::from_axis_angle(&Vector3::x_axis(), flip),
        _ => UnitQuaternion::from_axis_angle(&Vector3::x_axis(), if flip > 0.0 { 0.0 } else { 2.0 * FRAC_PI_2 }),
    };
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), rng.random_range(0.0..TAU)) * face
}

//! Rotates blocks so that all magnets that meet attract.
//!
//! For a block rotated by `R`, let `s_k` be the sign of the magnets on the face that points along +k in the drawing;
//! the magnets on the opposite face have the sign −s_k. Two blocks that touch along axis k attract exactly if their
//! `s_k` are equal. So each component connected by contacts along k shares one sign, and these signs are free, with one
//! exception: the product of a block's three signs is the determinant of the axis permutation. A block with two equal
//! sides can swap them and reaches all eight combinations. A block with three different sides (3x2x1) cannot, which
//! leaves one equation for each such block.

use super::brick::{Brick, Cell};
use super::dice::Dice;
use blueprints::lattice::is_odd;
use blueprints::pieces::pieces;
use blueprints::strength::Joint;
use blueprints::{CubeRotation, Inventory};

/// Returns a rotation for every brick, or `None` if the equations contradict each other.
pub(super) fn turned(bricks: &[Brick], joints: &[(usize, Joint)], dice: &mut Dice) -> Option<Vec<CubeRotation>> {
    let pieces: [Vec<usize>; 3] = std::array::from_fn(|axis| {
        let along = joints.iter().filter(|(k, _)| *k == axis).map(|(_, joint)| (joint.a, joint.b));
        pieces(bricks.len(), along)
    });
    let mut signs: [Vec<i32>; 3] =
        std::array::from_fn(|_| (0..bricks.len()).map(|_| if dice.chance(50) { 1 } else { -1 }).collect());
    // Equations already fixed by blocks with three different sides.
    let mut settled: Vec<[usize; 3]> = Vec::new();
    for (i, brick) in bricks.iter().enumerate() {
        let Some(parity) = parity(brick) else { continue };
        let own: [usize; 3] = std::array::from_fn(|k| pieces[k][i]);
        let product: i32 = (0..3).map(|k| signs[k][own[k]]).product();
        if product != parity {
            let free = (0..3).find(|&k| settled.iter().all(|other| other[k] != own[k]))?;
            signs[free][own[free]] *= -1;
        }
        settled.push(own);
    }
    let sign = |i: usize| std::array::from_fn(|k| signs[k][pieces[k][i]]);
    bricks.iter().enumerate().map(|(i, brick)| rotation(brick, sign(i), dice)).collect()
}

fn own_size(brick: &Brick) -> Cell {
    Inventory::standard().types()[brick.type_idx].cells.map(i32::from)
}

/// Returns the product of the three signs if it is fixed: the determinant of the permutation of three different sides.
fn parity(brick: &Brick) -> Option<i32> {
    is_odd(own_size(brick), brick.size).map(|is_odd| if is_odd { -1 } else { 1 })
}

/// Draws a rotation among those that give the brick's size and signs.
fn rotation(brick: &Brick, signs: [i32; 3], dice: &mut Dice) -> Option<CubeRotation> {
    let own = own_size(brick);
    let fits = |rotation: &CubeRotation| rotation.apply(own).map(i32::abs) == brick.size && rotation.signs() == signs;
    let fitting: Vec<CubeRotation> = CubeRotation::all().filter(fits).collect();
    (!fitting.is_empty()).then(|| dice.pick(&fitting))
}

#[cfg(test)]
mod tests {
    use super::*;
    use blueprints::Inventory;

    #[test]
    fn only_blocks_with_three_different_sides_have_fixed_parity() {
        let mut dice = Dice::new([0; 32]);
        for (type_idx, block_type) in Inventory::standard().types().iter().enumerate() {
            for turn in CubeRotation::all() {
                let size = turn.apply(block_type.cells.map(i32::from)).map(i32::abs);
                let brick = Brick { type_idx, low: [0, 0, 0], size };
                for bits in 0..8 {
                    let signs: [i32; 3] = std::array::from_fn(|k| if bits >> k & 1 == 0 { 1 } else { -1 });
                    let possible = parity(&brick).is_none_or(|parity| parity == signs.iter().product::<i32>());
                    let found = rotation(&brick, signs, &mut dice);
                    assert_eq!(found.is_some(), possible, "{} {size:?} {signs:?}", block_type.name);
                }
            }
        }
    }

    #[test]
    fn slabs_that_share_all_signs_need_the_same_permutation() {
        let slab = |low, size| Brick { type_idx: 5, low, size };
        let cube = |low| Brick { type_idx: 0, low, size: [1, 1, 1] };
        let check = |second: Brick, possible: bool| {
            // The two touch along z, and adjacent cubes couple their signs along x and y.
            let bricks = [
                slab([0, 0, 0], [3, 2, 1]),
                second,
                cube([3, 0, 0]),
                cube([3, 0, 1]),
                cube([0, 2, 0]),
                cube([0, 2, 1]),
            ];
            let joints = super::super::brick::joints(&bricks);
            for seed in 0..8 {
                assert_eq!(turned(&bricks, &joints, &mut Dice::new([seed; 32])).is_some(), possible, "{second:?}");
            }
        };
        check(slab([0, 0, 1], [3, 2, 1]), true);
        // Upright on the first: 3 along x, 1 along y, 2 up; its sign along y is free.
        check(slab([0, 0, 1], [3, 1, 2]), true);
    }
}

//! Assembly orders of hand-made structures and of the whole catalog.

use super::*;
use crate::{Blueprint, Catalog, CubeRotation};

/// Places the `k`-th block of a type with its lowest corner cell at `at`, rotated so that it fills `size` cells.
fn block(type_name: &str, k: usize, at: [i32; 3], size: [i32; 3]) -> Placement {
    let inventory = crate::Inventory::standard();
    let block = inventory.blocks_of_type(type_name)[k];
    let cells = inventory.cells(block).map(i32::from);
    let rotation = CubeRotation::all().find(|r| r.apply(cells).map(i32::abs) == size).unwrap();
    Placement { block, center_half_units: std::array::from_fn(|i| 2 * at[i] + size[i]), rotation }
}

fn cube(k: usize, at: [i32; 3]) -> Placement {
    block("1x1x1", k, at, [1, 1, 1])
}

#[test]
fn tower_is_built_upward_with_each_cube_from_above() {
    let tower = [cube(2, [0, 0, 2]), cube(0, [0, 0, 0]), cube(1, [0, 0, 1])];
    let mut assembly = Assembly::of_placements(&tower).unwrap();
    let upright = (0..assembly.n_sides()).find(|&side| assembly.up(side) == [0, 0, 1]).unwrap();
    assert_eq!(assembly.next(upright, Parts::default()), Some(1));
    assert_eq!(assembly.next(upright, Parts::one(1)), Some(2));
    let ground = Parts::one(1);
    let way = assembly.approach(upright, ground, Parts::one(2)).unwrap();
    assert_eq!((way.direction, way.length_half_units), ([0, 0, 1], 3));
    // The upper cube cannot be placed before the middle one, and nothing goes under a standing cube.
    assert_eq!(assembly.approach(upright, ground, Parts::one(0)), None);
    assert_eq!(assembly.approach(upright, Parts::one(0), Parts::one(2)), None);
}

#[test]
fn part_between_two_faces_cannot_come_last() {
    // Three cubes in a row on a bar: the middle one cannot come last.
    let row = [block("3x1x1", 0, [0, 0, 0], [3, 1, 1]), cube(0, [0, 0, 1]), cube(1, [1, 0, 1]), cube(2, [2, 0, 1])];
    let mut assembly = Assembly::of_placements(&row).unwrap();
    for side in 0..assembly.n_sides() {
        let without_middle = assembly.geometry.all().without(Parts::one(2));
        assert_eq!(assembly.approach(side, without_middle, Parts::one(2)), None);
        assert!(!assembly.is_safe(side, without_middle));
    }
    let upright = (0..assembly.n_sides()).find(|&side| assembly.up(side) == [0, 0, 1]).unwrap();
    assert!(assembly.is_safe(upright, Parts::one(0)));
}

/// Returns six arms around a cube, a structure without an assembly order.
pub(crate) fn jack() -> Vec<Placement> {
    vec![
        cube(0, [0, 0, 0]),
        block("4x1x1", 0, [1, 0, 0], [4, 1, 1]),
        block("4x1x1", 1, [-4, 0, 0], [4, 1, 1]),
        block("3x1x1", 0, [0, 1, 0], [1, 3, 1]),
        block("3x1x1", 1, [0, -3, 0], [1, 3, 1]),
        block("2x1x1", 0, [0, 0, 1], [1, 1, 2]),
        block("2x1x1", 1, [0, 0, -2], [1, 1, 2]),
    ]
}

#[test]
fn jack_with_long_arms_has_no_order() {
    // Whichever arm it stands on, the first long arm to the side tips it. On an arm of 4, with the cube, the other arm
    // of 4, and both arms of 2 in place, an arm of 3 moves the center by 3 · 2 / 16 = 0.375, which leaves a margin of
    // 0.125.
    let NoAssembly { missing, gave_up } = Assembly::of_placements(&jack()).unwrap_err();
    assert!(!missing.is_empty() && missing.len() < jack().len() && !gave_up, "{missing:?}");
}

#[test]
fn overhanging_structure_is_not_built_upright() {
    // A bar of 4 across the end of a post always tips it. Lying down, the structure cannot tip.
    let crane = [
        block("2x1x1", 0, [0, 0, 0], [1, 1, 2]),
        block("4x1x1", 0, [0, 0, 2], [4, 1, 1]),
        block("2x2x1", 0, [0, 0, 3], [2, 1, 2]),
    ];
    let assembly = Assembly::of_placements(&crane).unwrap();
    let upright = |a: &Assembly| (0..a.n_sides()).any(|side| a.up(side) == [0, 0, 1]);
    // Volumes 2, 4, 4 with centers at 0.5, 2 and 1: the mean is 1.3, and the post ends at 1.
    assert!(!upright(&assembly));
}

#[test]
fn every_step_of_an_order_stands_and_has_an_approach() {
    for blueprint in Catalog::builtin().iter() {
        let mut assembly = Assembly::new(blueprint).unwrap();
        for side in 0..assembly.n_sides() {
            let mut placed = Parts::default();
            while let Some(part) = assembly.next(side, placed) {
                assert!(placed.is_empty() || assembly.approach(side, placed, Parts::one(part)).is_some());
                placed = placed.with(part);
                assert!(assembly.margin_u(side, placed) >= MIN_BUILD_MARGIN_U, "{}", blueprint.id());
            }
            assert_eq!(placed, assembly.geometry.all(), "{}", blueprint.id());
        }
    }
}

/// Returns a complete assembly order on the best side.
fn order(blueprint: &Blueprint) -> Vec<BlockIdx> {
    let mut assembly = Assembly::new(blueprint).unwrap();
    let mut placed = Parts::default();
    let mut order = Vec::new();
    while let Some(part) = assembly.next(0, placed) {
        placed = placed.with(part);
        order.push(assembly.blocks[part]);
    }
    order
}

#[test]
fn copies_on_other_blocks_have_the_same_order() {
    for blueprint in Catalog::builtin().iter().step_by(11) {
        // Reverse the blocks of each type.
        let swapped = BlockIdx::array(|block| {
            let same: Vec<BlockIdx> = crate::Inventory::standard().same_type(block).collect();
            let place = same.iter().position(|other| *other == block).unwrap();
            same[same.len() - 1 - place]
        });
        let copy = blueprint.permuted(&swapped);
        let expected: Vec<BlockIdx> = order(blueprint).iter().map(|block| swapped[block.get()]).collect();
        assert_eq!(order(&copy), expected, "{}", blueprint.id());
    }
}

//! The inventory: counts, order and magnets.

use blueprints::{BlockIdx, CubeRotation, Inventory, Polarity, RelativePlacement};

fn block(index: u8) -> BlockIdx {
    BlockIdx::try_from(index).expect("tests name blocks 0..16")
}

#[test]
fn standard_inventory_has_16_blocks_of_6_types_in_order() {
    let names: Vec<_> = BlockIdx::all().map(|b| Inventory::standard().block_type(b).name).collect();
    let expected = [
        "1x1x1", "1x1x1", "1x1x1", "1x1x1", "2x1x1", "2x1x1", "2x1x1", "2x1x1", "3x1x1", "3x1x1", "4x1x1", "4x1x1",
        "2x2x1", "2x2x1", "3x2x1", "3x2x1",
    ];
    assert_eq!(names, expected);
    assert_eq!(Inventory::standard().types().len(), 6);
    assert_eq!(Inventory::standard().blocks_of_type("3x1x1"), [block(8), block(9)]);
    assert_eq!(Inventory::standard().blocks_of_type("9x9x9"), []);
    assert!(Inventory::standard().same_type(block(5)).eq((4..8).map(block)));
    assert_eq!(Inventory::standard().half_extents_m(block(14)), [0.15, 0.1, 0.05]);
}

#[test]
fn every_face_cell_has_a_magnet() {
    // A cuboid a × b × c has 2(ab + bc + ca) unit faces: 6, 10, 14, 18, 16 and 22.
    let n_magnets = |index| Inventory::standard().magnets(block(index)).len();
    assert_eq!([0, 4, 8, 10, 12, 14].map(n_magnets), [6, 10, 14, 18, 16, 22]);
    // 4·6 + 4·10 + 2·14 + 2·18 + 2·16 + 2·22.
    assert_eq!(BlockIdx::all().map(|b| Inventory::standard().magnets(b).len()).sum::<usize>(), 204);
    for b in BlockIdx::all() {
        let cells = Inventory::standard().cells(b).map(i32::from);
        for magnet in Inventory::standard().magnets(b) {
            let axis = magnet.normal.iter().position(|&x| x != 0).expect("a normal is an axis");
            assert_eq!(magnet.position_half_units[axis], magnet.normal[axis] * cells[axis]);
            assert_eq!(magnet.polarity == Polarity::Positive, magnet.normal[axis] > 0);
        }
    }
}

#[test]
fn magnets_of_touching_faces_pair_by_cell() {
    let inventory = Inventory::standard();
    let check = |a: u8, b: u8, offset_half_units, rotation, n_attract: usize, n_repel: usize| {
        let a = block(a);
        let b = block(b);
        let relative = RelativePlacement { offset_half_units, rotation };
        assert_eq!(inventory.magnet_pairs(a, b, relative).len(), n_attract, "{relative:?}");
        assert_eq!(inventory.clashing_pairs(a, b, relative).len(), n_repel, "{relative:?}");
        assert_eq!(inventory.magnet_pairs(b, a, relative.inverse()).len(), n_attract, "{relative:?} inverse");
    };
    let same = CubeRotation::IDENTITY;
    // A rotation about x by π points b's +z face down.
    let upside_down = CubeRotation::from_axes("+x -y").expect("they are axes");
    check(12, 13, [0, 0, 2], same, 4, 0);
    check(12, 13, [0, 0, 2], upside_down, 0, 4);
    check(12, 13, [2, 2, 2], same, 1, 0);
    check(0, 4, [3, 0, 0], same, 1, 0);
    check(0, 4, [1, 0, 2], same, 1, 0);
    // Half a cell off, the faces touch but the magnets do not meet.
    check(0, 4, [0, 0, 2], same, 0, 0);
    check(0, 1, [4, 0, 0], same, 0, 0);
}

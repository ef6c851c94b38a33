//! Hashes of a structure and its outline that are invariant to rotation, translation, and block numbering. They
//! identify duplicates and structures of equal shape.

use crate::hash::fnv1a;
use crate::{Blueprint, CubeRotation, Inventory};

/// The permutations of three axes.
const AXIS_ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];

impl Blueprint {
    /// Returns a hash that is the same for two blueprints exactly when one can be rotated (24 rotations) and moved onto
    /// the other with blocks of the same types in the same orientations, up to 64-bit collisions.
    ///
    /// Mirror images have different hashes: a reflection maps no block onto itself, because it would swap a face's
    /// magnets. The hash does not depend on id, split, title, or the program's version.
    pub fn canonical_hash(&self) -> u64 {
        // Of the smallest, over the 24 rotations, of the sorted lists of (size, center, rotation) as bytes.
        fnv1a(CubeRotation::all().map(|rotation| self.form_turned_by(rotation)).min().unwrap_or_default())
    }

    /// Returns a hash that is the same for two blueprints exactly when they fill the same cells up to translation and
    /// the 48 symmetries of the cube, up to 64-bit collisions.
    ///
    /// So it does not change if a structure is rotated or mirrored, if its poles are swapped, or if other blocks fill
    /// the same cells. It costs about as much as [`Self::canonical_hash`].
    pub fn outline_hash(&self) -> u64 {
        outline_hash(self.placements().iter().flat_map(|p| p.filled_cells()).collect())
    }

    fn form_turned_by(&self, rotation: CubeRotation) -> Vec<u8> {
        let centers: Vec<[i32; 3]> = self.placements().iter().map(|p| rotation.apply(p.center_half_units)).collect();
        let lowest: [i32; 3] = std::array::from_fn(|k| centers.iter().map(|c| c[k]).min().unwrap_or(0));
        let mut rows: Vec<_> = (self.placements().iter().zip(&centers))
            .map(|(placement, center)| {
                let cells = Inventory::standard().cells(placement.block);
                let moved: [i32; 3] = std::array::from_fn(|k| center[k] - lowest[k]);
                (cells, moved, u8::from(rotation.compose(placement.rotation)))
            })
            .collect();
        rows.sort_unstable();
        let mut bytes = Vec::new();
        for (cells, center, orientation) in rows {
            bytes.extend(cells);
            bytes.extend(center.iter().flat_map(|x| x.to_le_bytes()));
            bytes.push(orientation);
        }
        bytes
    }
}

/// Hashes the smallest sorted list of cells over the symmetries that put the extents in ascending order. These lists
/// are the same for every pose of an outline, and if all extents differ there are 8 of them instead of 48.
fn outline_hash(cells: Vec<[i32; 3]>) -> u64 {
    let low: [i32; 3] = std::array::from_fn(|k| cells.iter().map(|cell| cell[k]).min().unwrap_or(0));
    let high: [i32; 3] = std::array::from_fn(|k| cells.iter().map(|cell| cell[k]).max().unwrap_or(0));
    let ascending = |order: &&[usize; 3]| order.map(|k| high[k] - low[k]).is_sorted();
    let posed = AXIS_ORDERS.iter().filter(ascending).flat_map(|order| {
        let cells = &cells;
        (0..8).map(move |flips| {
            let along =
                |cell: &[i32; 3], k: usize| if (flips >> k) & 1 == 0 { cell[k] - low[k] } else { high[k] - cell[k] };
            let mut posed: Vec<[i32; 3]> = cells.iter().map(|cell| order.map(|k| along(cell, k))).collect();
            posed.sort_unstable();
            posed
        })
    });
    let smallest = posed.min().unwrap_or_default();
    fnv1a(smallest.into_iter().flatten().flat_map(i32::to_le_bytes))
}

#[cfg(test)]
mod tests {
    use super::outline_hash;
    use crate::assembly::Shared;
    use crate::{BlockIdx, Blueprint, Catalog, CubeRotation, N_BLOCKS, Placement, Split};

    fn turned(blueprint: &Blueprint, turn: CubeRotation) -> Blueprint {
        let place = |p: &Placement| Placement {
            // Move by whole units, so that blocks stay on cells.
            center_half_units: turn.apply(p.center_half_units).map(|x| x + 8),
            rotation: turn.compose(p.rotation),
            ..*p
        };
        placed(blueprint, blueprint.placements.iter().map(place).collect())
    }

    #[test]
    fn hash_is_invariant_to_rotation_translation_and_renumbering() {
        // Reverses the blocks within each type, which has 4, 4, 2, 2, 2, and 2 of them.
        let reversed: [u8; N_BLOCKS] = [3, 2, 1, 0, 7, 6, 5, 4, 9, 8, 11, 10, 13, 12, 15, 14];
        let reversed = reversed.map(|i| BlockIdx::try_from(i).unwrap());
        for blueprint in Catalog::builtin().iter() {
            let hash = blueprint.canonical_hash();
            assert_eq!(blueprint.permuted(&reversed).canonical_hash(), hash, "{}", blueprint.id());
            for turn in CubeRotation::all() {
                assert_eq!(turned(blueprint, turn).canonical_hash(), hash, "{} {turn:?}", blueprint.id());
            }
        }
    }

    #[test]
    fn mirror_image_has_a_different_hash() {
        // Four cubes: one at the origin, one next to it in +x, one in +y, and one two cells in +y and one up; or the
        // same with x and y swapped.
        let bars = |x_first: bool| {
            let at = |block: u8, center: [i32; 3]| Placement {
                block: BlockIdx::try_from(block).unwrap(),
                center_half_units: if x_first { center } else { [center[1], center[0], center[2]] },
                rotation: CubeRotation::IDENTITY,
            };
            let placements = vec![at(0, [1, 1, 1]), at(1, [3, 1, 1]), at(2, [1, 3, 1]), at(3, [1, 5, 3])];
            placed(Catalog::builtin().iter().next().unwrap(), placements)
        };
        assert_ne!(bars(true).canonical_hash(), bars(false).canonical_hash());
        assert_eq!(bars(true).canonical_hash(), bars(true).canonical_hash());
    }

    /// Returns the blueprint with other placements and its original links.
    fn placed(blueprint: &Blueprint, placements: Vec<Placement>) -> Blueprint {
        Blueprint { assembly: Shared::new(&placements), placements, ..blueprint.clone() }
    }

    /// Returns the mirror image across the plane where an axis's coordinate is 0. A box is its own mirror image.
    fn mirrored(blueprint: &Blueprint, axis: usize) -> Blueprint {
        let mirror = |p: &Placement| {
            let mut mirrored = *p;
            mirrored.center_half_units[axis] = -p.center_half_units[axis];
            mirrored
        };
        placed(blueprint, blueprint.placements.iter().map(mirror).collect())
    }

    /// Rotates every block by a half turn about one of its own axes, which swaps the poles on its other faces.
    fn with_other_poles(blueprint: &Blueprint, half_turn: CubeRotation) -> Blueprint {
        let turn = |p: &Placement| Placement { rotation: p.rotation.compose(half_turn), ..*p };
        placed(blueprint, blueprint.placements.iter().map(turn).collect())
    }

    /// Fills each of the same cells with a cube. The inventory has fewer cubes, but the outline hash does not check
    /// that.
    fn retiled(blueprint: &Blueprint) -> Blueprint {
        let cells = blueprint.placements.iter().flat_map(|p| p.filled_cells());
        let cube = |cell: [i32; 3]| Placement {
            block: BlockIdx::try_from(0).unwrap(),
            center_half_units: cell.map(|x| 2 * x + 1),
            rotation: CubeRotation::IDENTITY,
        };
        placed(blueprint, cells.map(cube).collect())
    }

    #[test]
    fn held_out_outlines_are_refused_mirrored_with_other_poles_and_retiled() {
        let catalog = Catalog::builtin();
        let half_turns: Vec<CubeRotation> = CubeRotation::all()
            .filter(|&turn| {
                turn != CubeRotation::IDENTITY
                    && [[1, 0, 0], [0, 1, 0], [0, 0, 1]].into_iter().all(|axis| turn.apply(axis).map(i32::abs) == axis)
            })
            .collect();
        assert_eq!(half_turns.len(), 3);
        let held_out: Vec<&Blueprint> = catalog.iter().filter(|b| b.split() != Split::Train).collect();
        assert_eq!(held_out.len(), 24 + 34);
        for blueprint in held_out {
            let mut others: Vec<Blueprint> = (0..3).map(|axis| mirrored(blueprint, axis)).collect();
            others.extend(half_turns.iter().map(|&turn| with_other_poles(blueprint, turn)));
            others.push(retiled(blueprint));
            // The canonical hash takes at least one of them for a different structure and would let it pass.
            assert!(others.iter().any(|other| other.canonical_hash() != blueprint.canonical_hash()));
            for other in others {
                for turn in [CubeRotation::IDENTITY, half_turns[0], CubeRotation::try_from(7).unwrap()] {
                    assert!(!catalog.is_for_training(&turned(&other, turn)), "{} {turn:?}", blueprint.id());
                }
            }
            // Removing a block changes the outline.
            let less = placed(blueprint, blueprint.placements[1..].to_vec());
            assert!(catalog.is_for_training(&less), "{}", blueprint.id());
        }
    }

    #[test]
    fn outlines_are_equal_up_to_the_symmetries_of_the_cube() {
        // A chiral piece of five cells, its mirror image, and another piece of five cells with the same extents.
        let chiral = vec![[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 2, 1]];
        let hash = outline_hash(chiral.clone());
        for [x, y, z] in [[0, 1, 2], [2, 0, 1], [1, 0, 2]] {
            for signs in [[1, 1, 1], [-1, 1, 1], [1, -1, -1]] {
                let posed =
                    chiral.iter().map(|cell| [signs[0] * cell[x] + 5, signs[1] * cell[y], signs[2] * cell[z] - 3]);
                assert_eq!(outline_hash(posed.rev().collect()), hash);
            }
        }
        assert_ne!(outline_hash(vec![[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 2, 0], [1, 2, 1]]), hash);
    }
}

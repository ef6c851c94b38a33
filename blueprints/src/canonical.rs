//! A hash that is independent of rotation, translation, and numbering, to find duplicates.

use crate::hash::fnv1a;
use crate::{Blueprint, CubeRotation, Inventory};

impl Blueprint {
    /// A hash that is the same for two blueprints exactly when one can be turned (24 rotations) and moved onto the
    /// other with blocks of the same types in the same orientations, up to collisions of 64 bits.
    ///
    /// Mirror images have different hashes: a reflection maps no block onto itself, because it would swap a face's
    /// magnets. The hash does not depend on id, split, title, or the program's version.
    pub fn canonical_hash(&self) -> u64 {
        fnv1a(self.canonical_form())
    }

    /// The smallest, over the 24 rotations, of the sorted lists of (size, center, rotation) as bytes.
    fn canonical_form(&self) -> Vec<u8> {
        CubeRotation::all().map(|rotation| self.form_turned_by(rotation)).min().unwrap_or_default()
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

#[cfg(test)]
mod tests {
    use crate::assembly::Shared;
    use crate::{BlockIdx, Blueprint, Catalog, CubeRotation, N_BLOCKS, Placement, Split};

    fn turned(blueprint: &Blueprint, turn: CubeRotation) -> Blueprint {
        let place = |p: &Placement| Placement {
            center_half_units: turn.apply(p.center_half_units).map(|x| x + 7),
            rotation: turn.compose(p.rotation),
            ..*p
        };
        let placements: Vec<_> = blueprint.placements.iter().map(place).collect();
        Blueprint { assembly: Shared::new(&placements), placements, ..blueprint.clone() }
    }

    #[test]
    fn hash_is_invariant_to_rotation_translation_and_renumbering() {
        // Reverses the blocks inside each type: 4, 4, 2, 2, 2 and 2 of them.
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
        // A cube 0, a bar in +x of it, a longer bar in +y of it, and the same with +x and +y exchanged.
        let bars = |x_first: bool| {
            let at = |block: u8, center: [i32; 3]| Placement {
                block: BlockIdx::try_from(block).unwrap(),
                center_half_units: if x_first { center } else { [center[1], center[0], center[2]] },
                rotation: CubeRotation::IDENTITY,
            };
            let placements = vec![at(0, [1, 1, 1]), at(1, [3, 1, 1]), at(2, [1, 3, 1]), at(3, [1, 5, 3])];
            let id = "4_999".parse().unwrap();
            let assembly = Shared::new(&placements);
            Blueprint { id, split: Split::Train, title: String::new(), placements, links: Vec::new(), assembly }
        };
        assert_ne!(bars(true).canonical_hash(), bars(false).canonical_hash());
        assert_eq!(bars(true).canonical_hash(), bars(true).canonical_hash());
    }
}

//! Where a block of a structure is.

use crate::{BlockIdx, CubeRotation, Inventory, RelativePlacement, UNIT_M};

/// One block of a blueprint on the lattice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Placement {
    /// The block of the inventory.
    pub block: BlockIdx,
    /// Center in half units (0.05 m), blueprint frame, z up; the lowest cell rests on z = 0.
    pub center_half_units: [i32; 3],
    /// Orientation in the blueprint frame.
    pub rotation: CubeRotation,
}

impl Placement {
    /// Returns the center in meters, blueprint frame.
    pub fn position_m(&self) -> nalgebra::Vector3<f32> {
        nalgebra::Vector3::from(self.center_half_units.map(|x| x as f32 * (UNIT_M / 2.0)))
    }

    /// Returns the size in unit cells along the blueprint's axes.
    pub fn size_cells(&self) -> [i32; 3] {
        self.rotation.apply(Inventory::standard().cells(self.block).map(i32::from)).map(i32::abs)
    }

    /// Returns the lowest-numbered corner cell that the block fills.
    pub(crate) fn lowest_cell(&self) -> [i32; 3] {
        let size = self.size_cells();
        std::array::from_fn(|k| (self.center_half_units[k] - size[k]) / 2)
    }

    /// Returns the unit cells that the block fills, each as its lowest corner in units, in increasing order.
    pub fn filled_cells(&self) -> Vec<[i32; 3]> {
        let (low, size) = (self.lowest_cell(), self.size_cells());
        let mut cells = Vec::new();
        for x in low[0]..low[0] + size[0] {
            for y in low[1]..low[1] + size[1] {
                cells.extend((low[2]..low[2] + size[2]).map(|z| [x, y, z]));
            }
        }
        cells
    }
}

/// Returns the size of a structure along x, y, and z, in units.
pub fn extent_u(placements: &[Placement]) -> [i32; 3] {
    std::array::from_fn(|k| {
        let ends = |sign: i32| placements.iter().map(move |p| p.center_half_units[k] + sign * p.size_cells()[k]);
        (ends(1).max().unwrap_or(0) - ends(-1).min().unwrap_or(0)) / 2
    })
}

/// Moves a structure's lowest corner to the origin.
pub fn move_to_origin(placements: &mut [Placement]) {
    let corner = |p: &Placement, k: usize| p.center_half_units[k] - p.size_cells()[k];
    let lowest: [i32; 3] = std::array::from_fn(|k| placements.iter().map(|p| corner(p, k)).min().unwrap_or(0));
    for placement in placements {
        placement.center_half_units = std::array::from_fn(|k| placement.center_half_units[k] - lowest[k]);
    }
}

impl RelativePlacement {
    /// Returns the pose of `b` relative to `a`.
    pub fn between(a: &Placement, b: &Placement) -> Self {
        let to_a = a.rotation.inverse();
        let offset = std::array::from_fn(|i| b.center_half_units[i] - a.center_half_units[i]);
        Self { offset_half_units: to_a.apply(offset), rotation: to_a.compose(b.rotation) }
    }
}

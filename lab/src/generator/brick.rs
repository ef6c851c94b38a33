//! Blocks as boxes of cells without magnet polarity, and the stock of available blocks.

use blueprints::strength::Joint;
use blueprints::{CubeRotation, Inventory, Placement};

/// A unit cell by its lowest corner, in units.
pub(super) type Cell = [i32; 3];

/// A block of a type with given extents at a given place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Brick {
    /// Position in [`Inventory::types`].
    pub(super) type_idx: usize,
    /// Lowest corner in units.
    pub(super) low: Cell,
    /// Cells along each axis.
    pub(super) size: [i32; 3],
}

/// The remaining blocks of each type.
#[derive(Clone, Debug)]
pub(super) struct Stock {
    /// Volume in cells and remaining number, by type.
    types: Vec<(i32, usize)>,
    /// The types by increasing volume.
    by_volume: Vec<usize>,
}

impl Brick {
    pub(super) fn volume(&self) -> i32 {
        self.size.iter().product()
    }

    pub(super) fn high(&self, axis: usize) -> i32 {
        self.low[axis] + self.size[axis]
    }

    /// Returns whether `wanted` holds for every cell; stops at the first cell for which it does not.
    pub(super) fn all_cells(&self, mut wanted: impl FnMut(Cell) -> bool) -> bool {
        let [x, y, z] = self.low;
        (x..self.high(0)).all(|i| (y..self.high(1)).all(|j| (z..self.high(2)).all(|k| wanted([i, j, k]))))
    }

    pub(super) fn cells(&self) -> Vec<Cell> {
        let mut cells = Vec::new();
        self.all_cells(|cell| {
            cells.push(cell);
            true
        });
        cells
    }

    pub(super) fn overlaps(&self, other: &Self) -> bool {
        (0..3).all(|k| self.low[k] < other.high(k) && other.low[k] < self.high(k))
    }

    /// Returns the axis along which two faces touch, and the positions of the shared magnets in half units.
    pub(super) fn contact(&self, other: &Self) -> Option<(usize, Vec<[i32; 3]>)> {
        let axis = (0..3).find(|&k| self.high(k) == other.low[k] || other.high(k) == self.low[k])?;
        let low: [i32; 3] = std::array::from_fn(|k| self.low[k].max(other.low[k]));
        let high: [i32; 3] = std::array::from_fn(|k| self.high(k).min(other.high(k)));
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        // Two boxes that meet at an edge touch along two axes but share no area.
        if high[u] <= low[u] || high[v] <= low[v] {
            return None;
        }
        let mut places = Vec::new();
        for at_u in low[u]..high[u] {
            for at_v in low[v]..high[v] {
                let mut place = [2 * low[axis]; 3];
                (place[u], place[v]) = (2 * at_u + 1, 2 * at_v + 1);
                places.push(place);
            }
        }
        Some((axis, places))
    }

    /// Returns the mirror image of the box. `plane` is the sum of the coordinates of a cell and its image along `axis`.
    pub(super) fn mirrored(&self, axis: usize, plane: i32) -> Self {
        let mut mirrored = *self;
        mirrored.low[axis] = plane + 1 - self.high(axis);
        mirrored
    }
}

/// Returns all pairs of bricks that touch, with the axis of contact.
pub(super) fn joints(bricks: &[Brick]) -> Vec<(usize, Joint)> {
    let mut joints = Vec::new();
    for (a, brick) in bricks.iter().enumerate() {
        for (b, other) in bricks.iter().enumerate().skip(a + 1) {
            joints.extend(brick.contact(other).map(|(axis, places)| (axis, Joint { a, b, places })));
        }
    }
    joints
}

/// Returns the bricks as placements sorted by type, height, and position, which use the blocks of each type in order.
///
/// `rotations[i]` belongs to `bricks[i]`. The stock never provides more blocks than the inventory has.
pub(super) fn placements(bricks: &[Brick], rotations: &[CubeRotation]) -> Vec<Placement> {
    let inventory = Inventory::standard();
    let mut sorted: Vec<(&Brick, CubeRotation)> = bricks.iter().zip(rotations.iter().copied()).collect();
    sorted.sort_by_key(|(b, _)| (b.type_idx, b.low[2], b.low[1], b.low[0]));
    let mut left: Vec<_> = inventory.types().iter().map(|t| inventory.blocks_of_type(t.name).into_iter()).collect();
    let place = |(brick, rotation): (&Brick, CubeRotation)| {
        let block = left[brick.type_idx].next().expect("the stock has no more blocks than the inventory");
        let center_half_units = std::array::from_fn(|k| 2 * brick.low[k] + brick.size[k]);
        Placement { block, center_half_units, rotation }
    };
    sorted.into_iter().map(place).collect()
}

impl Stock {
    pub(super) fn full() -> Self {
        let volume = |cells: [u8; 3]| cells.iter().map(|&n| i32::from(n)).product();
        let types: Vec<(i32, usize)> =
            Inventory::standard().types().iter().map(|t| (volume(t.cells), usize::from(t.count))).collect();
        let mut by_volume: Vec<usize> = (0..types.len()).collect();
        by_volume.sort_by_key(|&t| types[t].0);
        Self { types, by_volume }
    }

    pub(super) fn left(&self, type_idx: usize) -> usize {
        self.types[type_idx].1
    }

    pub(super) fn take(&mut self, type_idx: usize, n: usize) {
        self.types[type_idx].1 -= n;
    }

    pub(super) fn put_back(&mut self, type_idx: usize, n: usize) {
        self.types[type_idx].1 += n;
    }

    /// Returns the minimum and maximum volume of `n` of the remaining blocks, in cells.
    pub(super) fn volume_range(&self, n: usize) -> (i32, i32) {
        let sum = |order: &mut dyn Iterator<Item = &usize>| {
            let mut wanted = n;
            order.fold(0, |sum, &t| {
                let (volume, count) = self.types[t];
                let taken = count.min(wanted);
                wanted -= taken;
                sum + volume * taken as i32
            })
        };
        (sum(&mut self.by_volume.iter()), sum(&mut self.by_volume.iter().rev()))
    }
}

//! The 16 blocks of 6 types and their magnets.

use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

use crate::lattice::{RelativePlacement, UNIT_M};

/// Number of blocks in every world (paper, section "Magnetic Block Assembly Environment").
pub const N_BLOCKS: usize = 16;

/// Index of a block in the inventory, 0..16.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "u8", into = "u8")]
pub struct BlockIdx(u8);

/// A block index outside 0..16.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("block index {0} is not in 0..16")]
pub struct InvalidBlockIdx(pub u8);

impl TryFrom<u8> for BlockIdx {
    type Error = InvalidBlockIdx;

    fn try_from(index: u8) -> Result<Self, InvalidBlockIdx> {
        if usize::from(index) < N_BLOCKS { Ok(Self(index)) } else { Err(InvalidBlockIdx(index)) }
    }
}

impl From<BlockIdx> for u8 {
    fn from(block: BlockIdx) -> Self {
        block.0
    }
}

impl BlockIdx {
    /// Iterates over all 16 indices in order.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..N_BLOCKS as u8).map(Self)
    }

    /// Returns an array with one value per block.
    pub fn array<T>(mut f: impl FnMut(Self) -> T) -> [T; N_BLOCKS] {
        std::array::from_fn(|i| f(Self(i as u8)))
    }

    /// Returns the index as a `usize`, for arrays of [`N_BLOCKS`].
    pub fn get(self) -> usize {
        usize::from(self.0)
    }
}

/// One kind of cuboid block.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BlockType {
    /// Name as used in files, for example `2x1x1`.
    pub name: &'static str,
    /// Size in unit cells along the block's x, y and z.
    pub cells: [u8; 3],
    /// Number of these blocks in the inventory.
    pub count: u8,
}

/// The block types of every world. The paper gives no sizes; these are cuboids of unit cells of 0.1 m.
const TYPES: [BlockType; 6] = [
    BlockType { name: "1x1x1", cells: [1, 1, 1], count: 4 },
    BlockType { name: "2x1x1", cells: [2, 1, 1], count: 4 },
    BlockType { name: "3x1x1", cells: [3, 1, 1], count: 2 },
    BlockType { name: "4x1x1", cells: [4, 1, 1], count: 2 },
    BlockType { name: "2x2x1", cells: [2, 2, 1], count: 2 },
    BlockType { name: "3x2x1", cells: [3, 2, 1], count: 2 },
];

/// Sign of a magnet; opposite signs attract and connect.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Polarity {
    /// On the +x, +y and +z faces; drawn red.
    Positive,
    /// On the −x, −y and −z faces; drawn blue.
    Negative,
}

/// A magnet in its block's frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Magnet {
    /// Position from the block's center in half units (0.05 m).
    pub position_half_units: [i32; 3],
    /// Outward unit normal of the face.
    pub normal: [i32; 3],
    /// Sign, equal to the sign of the face's axis.
    pub polarity: Polarity,
}

/// The block types of a world, and the type of each of its 16 blocks.
///
/// Blocks are numbered in the order of the types, `count` of each.
#[derive(Clone, Debug)]
pub struct Inventory {
    type_of: [u8; N_BLOCKS],
    magnets: Vec<Vec<Magnet>>,
}

impl Inventory {
    /// Returns the inventory of the paper's world.
    pub fn standard() -> &'static Self {
        static STANDARD: LazyLock<Inventory> = LazyLock::new(|| {
            let of_type = |(idx, t): (u8, &BlockType)| std::iter::repeat_n(idx, usize::from(t.count));
            let type_of: Vec<u8> = (0..).zip(&TYPES).flat_map(of_type).collect();
            let magnets = TYPES.iter().map(|t| magnets_of(t.cells)).collect();
            Inventory { type_of: type_of.try_into().expect("the counts sum to 16"), magnets }
        });
        &STANDARD
    }

    /// Returns the types in the order of their blocks.
    pub fn types(&self) -> &'static [BlockType] {
        &TYPES
    }

    /// Returns the position of a block's type in [`types`](Self::types).
    pub fn type_idx(&self, block: BlockIdx) -> usize {
        usize::from(self.type_of[block.get()])
    }

    /// Returns the type of a block.
    pub fn block_type(&self, block: BlockIdx) -> &'static BlockType {
        &TYPES[self.type_idx(block)]
    }

    /// Returns the size of a block in unit cells along its own x, y, and z.
    pub fn cells(&self, block: BlockIdx) -> [u8; 3] {
        self.block_type(block).cells
    }

    /// Returns half of a block's size in meters along its own x, y, and z.
    pub fn half_extents_m(&self, block: BlockIdx) -> [f32; 3] {
        self.cells(block).map(|n| f32::from(n) * UNIT_M / 2.0)
    }

    /// Returns the magnets of a block, one at the center of every unit cell of every face.
    ///
    /// Order: faces +x −x +y −y +z −z, within a face by increasing position.
    pub fn magnets(&self, block: BlockIdx) -> &[Magnet] {
        &self.magnets[self.type_idx(block)]
    }

    /// Iterates over all blocks of the same type, including the block itself, in index order.
    pub fn same_type(&self, block: BlockIdx) -> impl Iterator<Item = BlockIdx> {
        BlockIdx::all().filter(move |&other| self.type_of[other.get()] == self.type_of[block.get()])
    }

    /// Returns all blocks of the named type in index order; empty for an unknown name.
    pub fn blocks_of_type(&self, name: &str) -> Vec<BlockIdx> {
        BlockIdx::all().filter(|&block| self.block_type(block).name == name).collect()
    }

    /// Returns the magnets of `a` and `b` that coincide, face each other, and attract, as indices into
    /// [`magnets`](Self::magnets) of each, ordered by `a`'s.
    ///
    /// `b_from_a` is the pose of `b` relative to `a`.
    pub fn magnet_pairs(&self, a: BlockIdx, b: BlockIdx, b_from_a: RelativePlacement) -> Vec<(usize, usize)> {
        self.coincident(a, b, b_from_a, |p, q| p != q)
    }

    /// Like [`magnet_pairs`](Self::magnet_pairs), for magnets that coincide and repel.
    pub fn clashing_pairs(&self, a: BlockIdx, b: BlockIdx, b_from_a: RelativePlacement) -> Vec<(usize, usize)> {
        self.coincident(a, b, b_from_a, |p, q| p == q)
    }

    fn coincident(
        &self,
        a: BlockIdx,
        b: BlockIdx,
        b_from_a: RelativePlacement,
        wanted: impl Fn(Polarity, Polarity) -> bool,
    ) -> Vec<(usize, usize)> {
        let RelativePlacement { offset_half_units: offset, rotation } = b_from_a;
        let seen_from_a = |magnet: &Magnet| {
            let turned = rotation.apply(magnet.position_half_units);
            let position_half_units = std::array::from_fn(|i| turned[i] + offset[i]);
            Magnet { position_half_units, normal: rotation.apply(magnet.normal), polarity: magnet.polarity }
        };
        let moved: Vec<Magnet> = self.magnets(b).iter().map(seen_from_a).collect();
        let mut pairs = Vec::new();
        for (i, p) in self.magnets(a).iter().enumerate() {
            for (j, q) in moved.iter().enumerate() {
                let meet = p.position_half_units == q.position_half_units && p.normal == q.normal.map(|x| -x);
                if meet && wanted(p.polarity, q.polarity) {
                    pairs.push((i, j));
                }
            }
        }
        pairs
    }
}

/// Returns the magnets of a cuboid. A unit cell's center is an odd number of half units from the cuboid's corner.
fn magnets_of(cells: [u8; 3]) -> Vec<Magnet> {
    let size = cells.map(i32::from);
    let centers = |axis: usize| (0..size[axis]).map(move |k| 2 * k + 1 - size[axis]);
    let mut magnets = Vec::new();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for (sign, polarity) in [(1, Polarity::Positive), (-1, Polarity::Negative)] {
            let mut normal = [0; 3];
            normal[axis] = sign;
            let mut places = Vec::new();
            for (pu, pv) in centers(u).flat_map(|pu| centers(v).map(move |pv| (pu, pv))) {
                let mut place = [0; 3];
                (place[axis], place[u], place[v]) = (sign * size[axis], pu, pv);
                places.push(place);
            }
            places.sort_unstable();
            let magnet = |position_half_units| Magnet { position_half_units, normal, polarity };
            magnets.extend(places.into_iter().map(magnet));
        }
    }
    magnets
}

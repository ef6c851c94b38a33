//! The 16 blocks of 6 types and their magnets.

use std::str::FromStr;
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
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BlockType {
    /// Name as used in files, for example `2x1x1`.
    pub name: String,
    /// Size in unit cells along the block's x, y and z.
    pub cells: [u8; 3],
    /// Number of these blocks in the inventory.
    pub count: u8,
}

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
/// Blocks are numbered in the order of the types in the data file, `count` of each.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Inventory {
    types: Vec<BlockType>,
    type_of: [u8; N_BLOCKS],
    magnets: Vec<Vec<Magnet>>,
}

/// Reasons to reject an inventory file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InventoryError {
    /// The text is not TOML or does not have the expected shape.
    #[error("not an inventory: {0}")]
    Syntax(String),
    /// The counts do not sum to [`N_BLOCKS`].
    #[error("the inventory holds {0} blocks, not 16")]
    WrongTotal(usize),
    /// Two types have the same name.
    #[error("block type {0:?} is listed twice")]
    DuplicateType(String),
    /// A side is outside 1..=8 cells.
    #[error("block type {name:?} has size {cells:?}; each side must be 1 to 8 cells")]
    BadSize {
        /// The type's name.
        name: String,
        /// Its size in cells.
        cells: [u8; 3],
    },
}

impl Inventory {
    /// Returns the inventory of the paper's world, read from `inventory.toml`.
    ///
    /// # Panics
    /// Never in a build that passes the tests: the file is compiled in.
    pub fn standard() -> &'static Self {
        static STANDARD: LazyLock<Inventory> =
            LazyLock::new(|| include_str!("../inventory.toml").parse().expect("the embedded inventory.toml is valid"));
        &STANDARD
    }

    /// Returns the types in the order of the file.
    pub fn types(&self) -> &[BlockType] {
        &self.types
    }

    /// Returns the position of a block's type in [`types`](Self::types).
    pub fn type_idx(&self, block: BlockIdx) -> usize {
        usize::from(self.type_of[block.get()])
    }

    /// Returns the type of a block.
    pub fn block_type(&self, block: BlockIdx) -> &BlockType {
        &self.types[self.type_idx(block)]
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

impl FromStr for Inventory {
    type Err = InventoryError;

    /// Reads an inventory from TOML: a list `types` of [`BlockType`]s whose counts sum to [`N_BLOCKS`].
    fn from_str(text: &str) -> Result<Self, InventoryError> {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct File {
            types: Vec<BlockType>,
        }
        let File { types } = toml::from_str(text).map_err(|error| InventoryError::Syntax(error.to_string()))?;
        for (i, block_type) in types.iter().enumerate() {
            if types[..i].iter().any(|other| other.name == block_type.name) {
                return Err(InventoryError::DuplicateType(block_type.name.clone()));
            }
            if block_type.cells.iter().any(|n| !(1..=8).contains(n)) {
                return Err(InventoryError::BadSize { name: block_type.name.clone(), cells: block_type.cells });
            }
        }
        let type_of: Vec<u8> =
            (0_u8..).zip(&types).flat_map(|(idx, t)| std::iter::repeat_n(idx, usize::from(t.count))).collect();
        let type_of = type_of.try_into().map_err(|all: Vec<u8>| InventoryError::WrongTotal(all.len()))?;
        let magnets = types.iter().map(|t| magnets_of(t.cells)).collect();
        Ok(Self { types, type_of, magnets })
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

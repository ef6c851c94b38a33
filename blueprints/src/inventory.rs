//! The 16 blocks of 6 types and their magnets.

use serde::{Deserialize, Serialize};

/// Number of blocks in every world (paper, section "Magnetic Block Assembly Environment").
pub const N_BLOCKS: usize = 16;

/// Edge of a unit cell in metres.
pub const UNIT_M: f32 = 0.1;

/// Index of a block in the inventory, 0..16.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "u8", into = "u8")]
pub struct BlockIdx(u8);

/// The error of a block index outside 0..16.
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
    /// All 16 indices in order.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..N_BLOCKS as u8).map(Self)
    }

    /// The index as a `usize`, for arrays of [`N_BLOCKS`].
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
    /// How many the inventory holds.
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
    /// Position from the block's centre in half units (0.05 m).
    pub position_half_units: [i32; 3],
    /// Outward unit normal of the face.
    pub normal: [i32; 3],
    /// Sign, equal to the sign of the face's axis.
    pub polarity: Polarity,
}

/// The blocks of a world: types, and the type of each of the 16 blocks.
///
/// Blocks are numbered in the order of the types in the data file, `count` of each.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Inventory {
    types: Vec<BlockType>,
    type_of: [u8; N_BLOCKS],
}

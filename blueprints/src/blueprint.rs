//! A target structure: which blocks, where, and which magnet pairs hold it together.

use serde::{Deserialize, Serialize};

use crate::{BlockIdx, CubeRotation, RelativePlacement};

/// Name of a blueprint, `<size>_<index>` as in the paper (`6_005`), with a prefix for the test sets.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct BlueprintId(String);

/// Which part of the catalogue a blueprint belongs to (paper, Table "Number of blueprint block distributions").
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Split {
    /// Seen in training.
    Train,
    /// Held out, same style as training.
    Test,
    /// Held out: recognisable objects.
    TestLiteral,
    /// Held out: largest horizontal extent.
    TestLongest,
    /// Held out: greatest height.
    TestTallest,
}

/// One block of a blueprint on the lattice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Placement {
    /// Which block of the inventory.
    pub block: BlockIdx,
    /// Centre in half units (0.05 m), blueprint frame, z up; the lowest cell rests on z = 0.
    pub center_half_units: [i32; 3],
    /// Orientation in the blueprint frame.
    pub rotation: CubeRotation,
}

/// A pair of blocks that touch with opposite magnets and must be connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Link {
    /// The lower block index.
    pub a: BlockIdx,
    /// The higher block index.
    pub b: BlockIdx,
    /// Pose of `b` seen from `a`.
    pub relative: RelativePlacement,
    /// Number of coincident opposite magnet pairs, at least 1.
    pub n_magnet_pairs: u8,
}

/// A validated target structure on concrete blocks of the inventory.
///
/// Invariants: blocks unique, no overlap, connected, every coincident magnet pair opposite and listed in `links`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Blueprint {
    pub(crate) id: BlueprintId,
    pub(crate) split: Split,
    pub(crate) placements: Vec<Placement>,
    pub(crate) links: Vec<Link>,
}

//! A target structure: its blocks, their placement, and the magnet pairs that hold it together.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::assembly::{Assembly, NoAssembly, Shared};
use crate::placement::extent_u;
use crate::{BlockIdx, N_BLOCKS, Placement, RelativePlacement};

/// Name of a blueprint: 1 to 64 letters, digits, `-`, and `_`, starting with a letter or digit.
///
/// Catalog names have the form `<size>_<index>` as in the paper (`6_005`), with a prefix for the held-out splits.
/// User-defined blueprints may have any name.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct BlueprintId(String);

/// The part of the catalog that a blueprint belongs to (paper, Table "Number of blueprint block distributions").
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Split {
    /// Seen in training.
    Train,
    /// Held out, same style as training.
    Test,
    /// Held out: recognizable objects.
    TestLiteral,
    /// Held out: largest horizontal extent.
    TestLongest,
    /// Held out: greatest height.
    TestTallest,
    /// Held out from training, for all decisions during development; not in the paper. It comes last to leave the order
    /// of the others unchanged.
    Validation,
}

/// A pair of blocks that touch with opposite magnets and must be connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Link {
    /// The lower block index.
    pub a: BlockIdx,
    /// The higher block index.
    pub b: BlockIdx,
    /// Pose of `b` relative to `a`.
    pub relative: RelativePlacement,
    /// Number of coincident opposite magnet pairs, at least 1.
    pub n_magnet_pairs: u8,
}

/// A validated target structure made of specific blocks of the inventory.
///
/// Invariants: blocks unique, no overlap, connected, every coincident magnet pair opposite and listed in `links`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Blueprint {
    pub(crate) id: BlueprintId,
    pub(crate) split: Split,
    pub(crate) title: String,
    pub(crate) placements: Vec<Placement>,
    pub(crate) links: Vec<Link>,
    pub(crate) assembly: Shared,
}

/// Maximum length of a [`BlueprintId`] in characters; ids serve as folder names and parts of keys.
pub const MAX_ID_LEN: usize = 64;

/// A string that is not a blueprint id.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not a blueprint id: 1 to {MAX_ID_LEN} letters, digits, - and _, the first a letter or a digit")]
pub struct InvalidBlueprintId(pub String);

/// An unknown split name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not a split; the splits are train, test, test-literal, test-longest, test-tallest and validation")]
pub struct InvalidSplit(pub String);

impl BlueprintId {
    /// Returns the id as a string.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Returns the number of blocks, 2 to 16, that an id of the catalog's form encodes; `None` for other ids.
    pub fn size(&self) -> Option<usize> {
        // The form is `[prefix_]<size>_<index>`.
        let (rest, index) = self.0.rsplit_once('_')?;
        let (prefix, size) = rest.rsplit_once('_').map_or((None, rest), |(prefix, size)| (Some(prefix), size));
        let digits = |s: &str| !s.is_empty() && s.bytes().all(|b| b.is_ascii_digit());
        let prefix_ok = prefix.is_none_or(|p| {
            p.starts_with(|c: char| c.is_ascii_lowercase())
                && p.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-')
        });
        if !prefix_ok || index.len() != 3 || !digits(index) || !digits(size) || size.starts_with('0') {
            return None;
        }
        size.parse().ok().filter(|n| (2..=N_BLOCKS).contains(n))
    }

    /// Derives an id from a file name, for files without one: every run of invalid characters becomes one `-`. Returns
    /// `None` if nothing is left.
    pub(crate) fn of_file(file: &str) -> Option<Self> {
        let stem = Path::new(file).file_stem()?.to_str()?;
        let words = stem.split(|c: char| !is_id_char(c)).filter(|word| !word.is_empty());
        let id = words.collect::<Vec<_>>().join("-");
        let id = id.trim_start_matches(['-', '_']);
        Self::try_from(id.chars().take(MAX_ID_LEN).collect::<String>()).ok()
    }
}

fn is_id_char(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '-' || c == '_'
}

impl TryFrom<String> for BlueprintId {
    type Error = InvalidBlueprintId;

    fn try_from(text: String) -> Result<Self, InvalidBlueprintId> {
        let is_id = text.starts_with(|c: char| c.is_ascii_alphanumeric())
            && text.len() <= MAX_ID_LEN
            && text.chars().all(is_id_char);
        if is_id { Ok(Self(text)) } else { Err(InvalidBlueprintId(text)) }
    }
}

impl FromStr for BlueprintId {
    type Err = InvalidBlueprintId;

    fn from_str(text: &str) -> Result<Self, InvalidBlueprintId> {
        Self::try_from(text.to_owned())
    }
}

impl From<BlueprintId> for String {
    fn from(id: BlueprintId) -> Self {
        id.0
    }
}

impl fmt::Display for BlueprintId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&self.0)
    }
}

impl Split {
    /// All splits, training first.
    pub const ALL: [Self; 6] =
        [Self::Train, Self::Test, Self::TestLiteral, Self::TestLongest, Self::TestTallest, Self::Validation];

    /// The paper's splits: training and test sets, with 142 and 24 blueprints in the built-in catalog.
    pub const PAPER: [Self; 5] = [Self::Train, Self::Test, Self::TestLiteral, Self::TestLongest, Self::TestTallest];
}

impl fmt::Display for Split {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // The name in files and JSON.
        self.serialize(f)
    }
}

impl FromStr for Split {
    type Err = InvalidSplit;

    fn from_str(text: &str) -> Result<Self, InvalidSplit> {
        Self::ALL.into_iter().find(|split| split.to_string() == text).ok_or_else(|| InvalidSplit(text.to_owned()))
    }
}

impl Blueprint {
    /// Returns the blueprint's id.
    pub fn id(&self) -> &BlueprintId {
        &self.id
    }

    /// Returns the split that the blueprint belongs to.
    pub fn split(&self) -> Split {
        self.split
    }

    /// Returns a short description of the structure.
    pub fn title(&self) -> &str {
        &self.title
    }

    /// Returns the placements, sorted by block index.
    pub fn placements(&self) -> &[Placement] {
        &self.placements
    }

    /// Returns the block pairs that must be connected, sorted by `(a, b)`.
    pub fn links(&self) -> &[Link] {
        &self.links
    }

    /// Returns the number of blocks, 2 to 16.
    pub fn n_blocks(&self) -> usize {
        self.placements.len()
    }

    /// Returns the size of the structure along its own x, y, and z (up), in units (0.1 m).
    pub fn extent_u(&self) -> [i32; 3] {
        extent_u(&self.placements)
    }

    /// Returns whether the block is part of the structure.
    pub fn contains(&self, block: BlockIdx) -> bool {
        self.placement(block).is_some()
    }

    /// Returns the placement of a block, or `None` if the structure does not use it.
    pub fn placement(&self, block: BlockIdx) -> Option<&Placement> {
        self.placements.binary_search_by_key(&block, |p| p.block).ok().map(|i| &self.placements[i])
    }

    /// Returns the target pose of `b` relative to `a`, linked or not; `None` if either is not in the structure.
    pub fn relative(&self, a: BlockIdx, b: BlockIdx) -> Option<RelativePlacement> {
        Some(RelativePlacement::between(self.placement(a)?, self.placement(b)?))
    }

    /// Returns the link between two blocks, given in either order.
    ///
    /// Its `relative` is always the pose of the block with the higher index relative to the one with the lower.
    pub fn link(&self, a: BlockIdx, b: BlockIdx) -> Option<&Link> {
        let key = (a.min(b), a.max(b));
        self.links.binary_search_by_key(&key, |link| (link.a, link.b)).ok().map(|i| &self.links[i])
    }

    /// Returns the same structure on other blocks: `permutation[i]` replaces block `i`.
    ///
    /// The result is a valid blueprint if `permutation` is a permutation and maps every block to one of the same type.
    pub fn permuted(&self, permutation: &[BlockIdx; N_BLOCKS]) -> Self {
        let place = |p: &Placement| Placement { block: permutation[p.block.get()], ..*p };
        let mut placements: Vec<_> = self.placements.iter().map(place).collect();
        placements.sort_by_key(|p| p.block);
        let relink = |link: &Link| {
            let (a, b) = (permutation[link.a.get()], permutation[link.b.get()]);
            if a < b { Link { a, b, ..*link } } else { Link { a: b, b: a, relative: link.relative.inverse(), ..*link } }
        };
        let mut links: Vec<_> = self.links.iter().map(relink).collect();
        links.sort_by_key(|link| (link.a, link.b));
        let assembly = self.assembly.replaced(|block| permutation[block.get()]);
        Self { placements, links, assembly, id: self.id.clone(), split: self.split, title: self.title.clone() }
    }
}

impl Assembly {
    /// Finds the sides on which the blueprint can be built. All copies of a blueprint share one search and number their
    /// parts alike, whichever blocks they use.
    ///
    /// # Errors
    /// If no side has an assembly order.
    pub fn new(blueprint: &Blueprint) -> Result<Self, NoAssembly> {
        blueprint.assembly.assembly(blueprint.placements())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_any_plain_words_and_those_of_the_catalog_say_their_size() {
        for (text, size) in [
            ("6_005", Some(6)),
            ("test_12_000", Some(12)),
            ("test-literal_10_000", Some(10)),
            ("my-tower_6_000", Some(6)),
            ("6_5", None),
            ("1_000", None),
            ("17_000", None),
            ("My-tower_2", None),
            ("x", None),
        ] {
            let id: BlueprintId = text.parse().unwrap();
            assert_eq!((id.to_string().as_str(), id.size()), (text, size));
        }
        for bad in ["", "-a", "_2_000", "2 000", "a/b", "../a", "a.toml", "a*", "ä", &"a".repeat(65)] {
            let error = bad.parse::<BlueprintId>().unwrap_err().to_string();
            assert!(error.starts_with(&format!("{bad:?} is not a blueprint id")), "{error}");
        }
    }

    #[test]
    fn splits_round_trip_and_other_texts_are_refused() {
        for split in Split::ALL {
            assert_eq!(split.to_string().parse(), Ok(split));
        }
        assert!("tset".parse::<Split>().unwrap_err().to_string().starts_with("\"tset\" is not a split"));
    }

    #[test]
    fn a_file_name_makes_an_id() {
        for (file, id) in [
            ("folder/my tower.v2.toml", Some("my-tower-v2")),
            ("tower.toml", Some("tower")),
            ("__a.toml", Some("a")),
            ("größe.toml", Some("gr-e")),
            ("...toml", None),
            ("", None),
        ] {
            assert_eq!(BlueprintId::of_file(file).as_ref().map(BlueprintId::as_str), id, "{file}");
        }
        assert_eq!(BlueprintId::of_file(&"a".repeat(99)).map(|id| id.as_str().len()), Some(MAX_ID_LEN));
    }
}

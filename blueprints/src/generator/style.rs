//! Styles of generated structures.

use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::N_BLOCKS;

/// The style of a generated structure. Its name, in ids, flags, and JSON, is the variant's in small letters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Style {
    /// Grown block by block, often mirrored.
    Any,
    /// A tapering tower, taller than wide.
    Tower,
    /// A thin wall, longer than tall, with battlements or a gate.
    Wall,
    /// Piers under a lintel.
    Arch,
    /// A deck on piers.
    Bridge,
    /// Steps: straight, up and down, or winding.
    Stairs,
    /// Layers that get smaller.
    Pyramid,
    /// A table, bench, or shelf.
    Table,
    /// A closed frame, lying or standing.
    Ring,
    /// A cross, lying or standing.
    Cross,
    /// A capital letter.
    Letter,
    /// A long row with ribs, shorter than style `longest`.
    Spine,
    /// As long as the stock and the checks allow.
    Longest,
    /// As tall as the stock and the checks allow.
    Tallest,
}

/// An unknown style name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not a style; the styles are {list}", list = Style::ALL.map(|style| style.to_string()).join(", "))]
pub struct InvalidStyle(pub String);

impl Style {
    /// All styles.
    pub const ALL: [Self; 14] = [
        Self::Any,
        Self::Tower,
        Self::Wall,
        Self::Arch,
        Self::Bridge,
        Self::Stairs,
        Self::Pyramid,
        Self::Table,
        Self::Ring,
        Self::Cross,
        Self::Letter,
        Self::Spine,
        Self::Longest,
        Self::Tallest,
    ];

    /// Returns the numbers of blocks for which the style is recognizable.
    pub fn sizes(self) -> RangeInclusive<usize> {
        let least = match self {
            Self::Any | Self::Tower | Self::Wall | Self::Stairs | Self::Pyramid | Self::Table => 2,
            Self::Arch | Self::Cross | Self::Letter => 3,
            Self::Bridge | Self::Ring | Self::Spine | Self::Longest | Self::Tallest => 4,
        };
        least..=N_BLOCKS
    }
}

impl fmt::Display for Style {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

impl FromStr for Style {
    type Err = InvalidStyle;

    fn from_str(text: &str) -> Result<Self, InvalidStyle> {
        Self::ALL.into_iter().find(|style| style.to_string() == text).ok_or_else(|| InvalidStyle(text.to_owned()))
    }
}

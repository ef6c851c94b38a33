//! Styles of generated structures.

use std::fmt;
use std::ops::RangeInclusive;

use blueprints::N_BLOCKS;
use clap::ValueEnum;
use clap::builder::PossibleValue;

/// The style of a generated structure. Its name, in ids and flags, is the variant's in small letters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, ValueEnum)]
pub(crate) enum Style {
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
    /// As long as the stock and the checks allow.
    Longest,
    /// As tall as the stock and the checks allow.
    Tallest,
}

impl Style {
    /// Returns the numbers of blocks for which the style is recognizable.
    pub(crate) fn sizes(self) -> RangeInclusive<usize> {
        let least = match self {
            Self::Any | Self::Tower | Self::Wall | Self::Stairs | Self::Pyramid | Self::Table => 2,
            Self::Arch | Self::Cross | Self::Letter => 3,
            Self::Bridge | Self::Ring | Self::Longest | Self::Tallest => 4,
        };
        least..=N_BLOCKS
    }
}

impl fmt::Display for Style {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.to_possible_value().as_ref().map_or("", PossibleValue::get_name))
    }
}

//! Blocks, magnets, the inventory, and target structures ("blueprints"), without physics.
//!
//! Reading order: [`lattice`] → [`inventory`] → [`placement`] → [`blueprint`] → the file [`mod@format`] and its
//! [`error`]s → [`stance`], `pieces`, and [`strength`] → inference of what a file leaves open (`infer`) → [`checks`] →
//! [`drawing`] → the file writer → the canonical hash → [`catalog`]. [`outside`] reads files and prints texts that
//! nobody vouches for, here and in other crates.

#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod assembly;
pub mod blueprint;
mod canonical;
pub mod catalog;
pub mod checks;
pub mod drawing;
pub mod error;
pub mod format;
pub mod group;
pub mod hash;
mod infer;
pub mod inventory;
pub mod lattice;
pub mod outside;
pub mod pieces;
pub mod placement;
pub mod stance;
pub mod strength;
mod writer;

pub use assembly::{Assembly, NoAssembly};
pub use blueprint::{Blueprint, BlueprintId, Link, Split};
pub use catalog::{Catalog, CatalogError};
pub use error::{BlueprintError, BlueprintFileError};
pub use group::{Group, InvalidGroup};
pub use inventory::{BlockIdx, BlockType, Inventory, Magnet, N_BLOCKS, Polarity};
pub use lattice::{CubeRotation, RelativePlacement, UNIT_M};
pub use placement::Placement;

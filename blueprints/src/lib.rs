//! Blocks, magnets, the inventory and the target structures ("blueprints"), with no physics and no I/O in the math.
//!
//! Reading order: [`lattice`] → [`inventory`] → [`blueprint`] → the file format, checks, hash and catalogue.

pub mod blueprint;
pub mod inventory;
pub mod lattice;

pub use blueprint::{Blueprint, BlueprintId, Link, Placement, Split};
pub use inventory::{BlockIdx, BlockType, Inventory, Magnet, N_BLOCKS, Polarity, UNIT_M};
pub use lattice::{CubeRotation, RelativePlacement};

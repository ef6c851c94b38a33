//! Episodes as datasets for offline learning: folders that [Minari](https://minari.farama.org) reads.
//!
//! Observations and actions are those of the environment `Lodestone/Assembly-v0` of the package for Python, so that what learns
//! from a dataset can act there.
//!
//! Reading order: [`spaces`] (what an observation and an action are) → [`episode`] (a trajectory as columns) → [`writer`] (the
//! folder).

#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod episode;
pub mod spaces;
pub mod writer;

pub use episode::EpisodeError;
pub use spaces::Spaces;
pub use writer::{About, DatasetError, DatasetId, InvalidDatasetId, Origin, World, Writer};

//! Records episodes as datasets for offline learning, in folders that [Minari](https://minari.farama.org) reads.
//!
//! Observations and actions are those of the environment `Lodestone/Assembly-v0` of the Python package, so that a
//! policy trained on a dataset can act there.
//!
//! Reading order: [`spaces`] (observation and action spaces) → [`episode`] (a trajectory as columns) → [`writer`] (the
//! folder).

#![cfg_attr(test, allow(clippy::unwrap_used))]

pub mod episode;
pub mod spaces;
pub mod writer;

pub use episode::EpisodeError;
pub use spaces::Spaces;
pub use writer::{About, DatasetError, DatasetId, InvalidDatasetId, Origin, World, Writer};

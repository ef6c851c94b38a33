//! Films that a running evaluator makes of its passes: of each group a success and a failure.
//!
//! Reading order: [`config`] → [`casting`] (which episodes of a pass are written down) → `studio` (a thread that draws
//! them) → `shelf` (where the files lie, and which go).

pub mod casting;
pub mod config;
mod shelf;
mod studio;
#[cfg(test)]
mod tests;

pub use casting::Casting;
pub use config::FilmsConfig;
pub(crate) use shelf::{Film, films};
pub(crate) use studio::Studio;

/// Folder of films in the folder of a run.
pub const VIDEOS: &str = "videos";

/// Folder of the recordings that films are made of, in the folder of a run.
pub const REPLAYS: &str = "replays";

/// Ending of the names of recordings.
pub(crate) const RECORDING: &str = "trajectory";

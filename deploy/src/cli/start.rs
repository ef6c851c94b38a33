//! How episodes begin, as an argument.

use clap::ValueEnum;
use evaluator::Starts;

/// How episodes begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum StartArg {
    /// All blocks scattered.
    Scattered,
    /// Another training blueprint is already built.
    Prebuilt,
    /// Every fifth episode prebuilt, the others scattered.
    Mixed,
}

impl From<StartArg> for Starts {
    fn from(start: StartArg) -> Self {
        match start {
            StartArg::Scattered => Self::Scattered,
            StartArg::Prebuilt => Self::Prebuilt,
            StartArg::Mixed => Self::Mixed,
        }
    }
}

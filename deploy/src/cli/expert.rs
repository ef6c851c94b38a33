//! Arguments of `expert`.

use std::ffi::OsString;
use std::path::PathBuf;

use blueprints::Split;
use clap::{Args, Subcommand, ValueEnum};
use evaluator::Starts;

/// Subcommands of `expert`.
#[derive(Debug, Subcommand)]
pub enum ExpertCommand {
    /// Evaluate the expert on blueprints, as policies are evaluated.
    Eval(ExpertEvalArgs),
}

/// Arguments of `expert eval`.
#[derive(Debug, Args)]
pub struct ExpertEvalArgs {
    /// Only these blueprints, by id: from the catalog, or generated.
    #[arg(value_name = "ID")]
    pub ids: Vec<OsString>,
    /// Only this blueprint: an id, a file, or a folder of files; may be repeated.
    #[arg(long, value_name = "FILE|ID")]
    pub blueprint: Vec<OsString>,
    /// Only this split of the catalog: train, test, test-literal, test-longest, test-tallest, or validation; may be
    /// repeated [default: all but validation].
    #[arg(long, value_name = "S", conflicts_with_all = ["ids", "blueprint"])]
    pub split: Vec<Split>,
    /// Episodes per blueprint.
    #[arg(long, value_name = "N", default_value_t = 40, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub episodes: u32,
    /// How episodes begin; mixed: every fifth with another blueprint already built.
    #[arg(long, value_enum, default_value_t = StartArg::Mixed)]
    pub start: StartArg,
    /// Grippers in the world [default: as configured].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=2))]
    pub grippers: Option<u8>,
    /// Also run reset-free sequences: 50 runs over 10 goals of at least 12 blocks.
    #[arg(long)]
    pub reset_free: bool,
    /// Seed of the start states.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// Threads [default: one per core].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=64))]
    pub threads: Option<u16>,
    /// Write the cause of each failure (failures.json) and a replay of it to this new folder.
    #[arg(long, value_name = "DIR")]
    pub explain: Option<PathBuf>,
    /// Write replays of the first success and the first failure of each group to this new folder, for `lodestone
    /// render`.
    #[arg(long, value_name = "DIR")]
    pub record: Option<PathBuf>,
    /// Set one configuration key, for example environment.max_speed_mps=2; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Print every blueprint, not only the groups and the worst blueprints.
    #[arg(long)]
    pub verbose: bool,
    /// Print the report as JSON.
    #[arg(long)]
    pub json: bool,
}

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

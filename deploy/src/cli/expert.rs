//! `expert …`.

use std::path::PathBuf;

use blueprints::Split;
use clap::{Args, Subcommand, ValueEnum};
use evaluator::Starts;

/// What the scripted expert is to do.
#[derive(Debug, Subcommand)]
pub enum ExpertCommand {
    /// Evaluate it on blueprints, as a policy is evaluated.
    Eval(ExpertEvalArgs),
}

/// Arguments of `expert eval`.
#[derive(Debug, Args)]
pub struct ExpertEvalArgs {
    /// These blueprints of the catalog only; generated ones by their id as well.
    #[arg(value_name = "ID")]
    pub ids: Vec<String>,
    /// This blueprint only: an id, a file, or a folder of files; may be repeated.
    #[arg(long, value_name = "FILE|ID")]
    pub blueprint: Vec<String>,
    /// This part of the catalog: train, test, test-literal, test-longest, test-tallest or validation; may be repeated
    /// [default: all but validation].
    #[arg(long, value_name = "S", conflicts_with_all = ["ids", "blueprint"])]
    pub split: Vec<Split>,
    /// Episodes per blueprint.
    #[arg(long, value_name = "N", default_value_t = 40, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub episodes: u32,
    /// How they begin; mixed: every fifth with another blueprint built.
    #[arg(long, value_enum, default_value_t = StartArg::Mixed)]
    pub start: StartArg,
    /// Grippers of the world [default: as configured].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=2))]
    pub grippers: Option<u8>,
    /// Then 50 runs over 10 goals of at least 12 blocks in a world that is never reset.
    #[arg(long)]
    pub reset_free: bool,
    /// Seed of the start states.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub seed: u64,
    /// Threads [default: one per core].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=64))]
    pub threads: Option<u16>,
    /// Write the cause of each failure (failures.json) and a replay of it into this new folder.
    #[arg(long, value_name = "DIR")]
    pub explain: Option<PathBuf>,
    /// Write a replay of the first success and of the first failure of each group into this new folder, for
    /// `lodestone render`.
    #[arg(long, value_name = "DIR")]
    pub record: Option<PathBuf>,
    /// Set one key of the configuration, for example environment.max_speed_mps=2; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Print every blueprint, not only the groups and the worst.
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
    /// Another training blueprint stands.
    Prebuilt,
    /// Every fifth prebuilt, the others scattered.
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

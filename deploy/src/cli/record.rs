//! Arguments of `record`.

use std::ffi::OsString;
use std::path::PathBuf;

use blueprints::Split;
use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use evaluator::Starts;

/// Arguments of `record`.
#[derive(Debug, Args)]
pub struct RecordArgs {
    /// The shipped policy; this is the default.
    #[arg(long, conflicts_with_all = ["checkpoint", "expert"])]
    pub(crate) pretrained: bool,
    /// Folder of a run (for its best policy, or else its newest checkpoint), of its `checkpoints` (for the newest), or of
    /// one of them, or a file written by `export`.
    #[arg(long, value_name = "DIR_OR_FILE")]
    pub(crate) checkpoint: Option<PathBuf>,
    /// The scripted expert.
    #[arg(long, conflicts_with = "checkpoint")]
    pub(crate) expert: bool,
    /// Sample the policy's actions instead of acting greedily.
    #[arg(long, conflicts_with = "expert")]
    pub(crate) sampled: bool,
    #[command(flatten)]
    pub(crate) goals: GoalArgs,
    /// Episodes per blueprint.
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub(crate) episodes: u32,
    /// How episodes begin; mixed: every fifth with another blueprint already built.
    #[arg(long, default_value = "scattered", value_parser = starts())]
    pub(crate) start: Starts,
    /// Seed of the start states and of sampled actions.
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub(crate) seed: u64,
    /// New folder for the trajectories, one file per episode.
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// Threads [default: one per core].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=64))]
    pub(crate) threads: Option<u16>,
    /// Set one configuration key, for example environment.episode_steps=200; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub(crate) set: Vec<String>,
}

/// The blueprints to build.
#[derive(Clone, Debug, Default, Args)]
#[group(required = true, multiple = false)]
pub struct GoalArgs {
    /// This blueprint: an id or a name such as scorpion, a file, or a folder of files; may be repeated.
    #[arg(long, value_name = "FILE|ID")]
    pub(crate) blueprint: Vec<OsString>,
    /// All blueprints of this split: train, test, test-literal, test-longest, test-tallest, or validation; may be
    /// repeated.
    #[arg(long, value_name = "SPLIT")]
    pub(crate) split: Vec<Split>,
}

fn starts() -> impl TypedValueParser<Value = Starts> {
    let all = [
        ("scattered", "All blocks scattered", Starts::Scattered),
        ("prebuilt", "Another training blueprint is already built", Starts::Prebuilt),
        ("mixed", "Every fifth episode prebuilt, the others scattered", Starts::Mixed),
    ];
    let values = PossibleValuesParser::new(all.map(|(name, help, _)| PossibleValue::new(name).help(help)));
    values.map(move |given| all.into_iter().find(|(name, ..)| *name == given).expect("it is one of them").2)
}

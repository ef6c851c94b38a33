//! Arguments of `sweep`.

use std::path::PathBuf;

use clap::Args;

use super::{ConfigArgs, values};

/// Arguments of `sweep`.
#[derive(Clone, Debug, Args)]
pub struct SweepArgs {
    /// Only print the table of the sweep in this folder, or do with it what --jobs or --only say.
    #[arg(value_name = "DIR", required_unless_present = "out", conflicts_with_all = ["out", "grid", "random", "seeds", "steps"])]
    #[arg(conflicts_with_all = ["config", "preset", "ablation", "set", "seed", "device", "run", "print_config"])]
    pub(crate) dir: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) config: ConfigArgs,
    /// A key of the configuration and its values, for example learner.gamma=0.95,0.97; may be repeated, for all
    /// combinations. The key `ablation` takes names of ablations, or `none`.
    #[arg(long, value_name = "KEY=V,V")]
    pub(crate) grid: Vec<String>,
    /// Draw this many points instead of all combinations. Values may then be ranges: KEY=2..8,
    /// KEY=0.9..0.99, or KEY=1e-4..1e-3:log.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=10_000))]
    pub(crate) random: Option<u16>,
    /// Train every point with this many seeds, from --seed on [default: 1].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=100))]
    pub(crate) seeds: Option<u16>,
    /// Environment steps of each run, for example 1e6.
    #[arg(long, value_name = "N", value_parser = values::steps, allow_negative_numbers = true)]
    pub(crate) steps: Option<i64>,
    /// Folder of the sweep. The same command goes on with what is there.
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// Runs at a time, each with its own actors and learner [default: 1].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1000))]
    pub(crate) jobs: Option<u16>,
    /// Train this run of the sweep in DIR alone; the first is 0.
    #[arg(long, value_name = "I", requires = "dir", conflicts_with = "jobs")]
    pub(crate) only: Option<usize>,
    /// Train nothing, but print a job array for Slurm's `sbatch`, with --jobs runs at a time [default: all].
    #[arg(long, requires = "out", conflicts_with = "json")]
    pub(crate) slurm: bool,
    /// Print the results, with curves, as JSON at the end; everything else goes to stderr.
    #[arg(long)]
    pub(crate) json: bool,
}

//! `report`.

use std::path::PathBuf;

use clap::Args;
use evaluator::Acting;

/// Arguments of `report`.
#[derive(Debug, Args)]
pub struct ReportArgs {
    /// Folder of the run, in which the evaluator keeps eval.db.
    #[arg(value_name = "RUN")]
    pub run: PathBuf,
    /// Folder for the pictures and tables; made if it is not there [default: RUN/report].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Which actions the pictures are about: mode, the most probable ones, or sampled.
    #[arg(long, value_name = "ACTING", default_value = "mode")]
    pub acting: Acting,
    /// Draw how much better or worse RUN is than this run as well.
    #[arg(long, value_name = "RUN2")]
    pub minus: Option<PathBuf>,
}

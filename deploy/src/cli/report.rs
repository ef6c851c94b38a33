//! `report`.

use std::path::PathBuf;

use clap::Args;
use proto::ActionMode;
use render::plot::MAX_RUNS;

/// Arguments of `report`.
#[derive(Clone, Debug, Args)]
pub struct ReportArgs {
    /// Folder of the run, in which the evaluator keeps eval.db, or of a training with --seeds.
    #[arg(value_name = "RUN")]
    pub run: PathBuf,
    /// Folder for the pictures and tables; made if it is not there [default: RUN/report].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Which actions the pictures are about: mode, the most probable ones, or sampled.
    #[arg(long, value_name = "ACTING", default_value = "mode")]
    pub acting: ActionMode,
    /// Draw how much better or worse RUN is than this run as well.
    #[arg(long, value_name = "RUN2")]
    pub minus: Option<PathBuf>,
    /// Draw RUN and these runs, at most four, in one picture as well, on the blueprints that all of them evaluated.
    #[arg(long, value_name = "RUN2", num_args = 1..MAX_RUNS)]
    pub beside: Vec<PathBuf>,
    /// Print the table of groups and the names of the files as JSON.
    #[arg(long)]
    pub json: bool,
}

//! Arguments of `report`.

use std::path::PathBuf;

use clap::Args;
use proto::ActionMode;

/// Arguments of `report`.
#[derive(Clone, Debug, Args)]
pub struct ReportArgs {
    /// Folder of a run, in which the evaluator keeps eval.db, or of a sweep.
    #[arg(value_name = "RUN")]
    pub(crate) run: PathBuf,
    /// Folder for the tables; created if it does not exist [default: RUN/report].
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// Actions of the tables by step: greedy or sampled.
    #[arg(long, value_name = "ACTING", default_value_t = ActionMode::Greedy)]
    pub(crate) acting: ActionMode,
    /// Also write the difference in success between RUN and this run.
    #[arg(long, value_name = "RUN2")]
    pub(crate) minus: Option<PathBuf>,
    /// Also write RUN and other runs into one table, on the blueprints that all of them evaluated.
    #[arg(long, value_name = "RUN2", num_args = 1..)]
    pub(crate) beside: Vec<PathBuf>,
    /// Print the table of groups and the names of the written files as JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

//! `bench`: measures the capacity of a run's processes and of their connections.

mod actors;
mod children;
mod parts;
mod record;
mod report;
mod text;
mod usage;
mod weights;

use super::on_runtime;
use crate::cli::BenchCommand;
use crate::exit::Failure;
use crate::live::Terminal;

/// Runs the subcommand.
///
/// # Errors
/// When a process cannot be started or fails, or the counts of both ends contradict each other.
pub(super) fn run(command: &BenchCommand, terminal: &Terminal) -> Result<(), Failure> {
    match command {
        BenchCommand::Actors(args) => actors::run(args, terminal),
        BenchCommand::Router => on_runtime(async |shutdown| parts::router(shutdown).await),
        BenchCommand::Ingest => on_runtime(async |shutdown| parts::ingest(shutdown).await),
        BenchCommand::Load => on_runtime(async |shutdown| parts::load(shutdown).await),
    }
}

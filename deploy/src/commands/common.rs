//! What several commands do.

use std::path::PathBuf;

use bus::{Bus, BusConfig, BusError};
use proto::Valid;
use tokio_util::sync::CancellationToken;

use crate::cli::{ConfigArgs, RunArgs, Settings};
use crate::config::Override;
use crate::exit::Failure;
use crate::live::Terminal;
use crate::run_dir::{Origin, RunDir, check_run};
use crate::shell::{self, program};

/// Where the run starts; prints a note if the given preset or file is ignored, or if there is no checkpoint to resume.
pub(super) fn origin(run: &RunArgs, config: &ConfigArgs, terminal: &Terminal) -> Result<Origin, Failure> {
    run.resume.as_deref().map_or(Ok(()), check_run)?;
    let origin = Origin::find(run);
    if let (Some(folder), None) = (&origin.config, &origin.checkpoint) {
        terminal.print(&format!("{} has no checkpoint yet: the run begins again", folder.display()));
    }
    if let (Some(folder), true) = (&origin.config, run.auto_resume) {
        let file = config.config.as_ref().map(|file| file.display().to_string()).or_else(|| config.preset.clone());
        let init = run.init_from.as_ref().filter(|_| origin.checkpoint.is_some());
        let ignored = file.into_iter().chain(init.map(|model| model.display().to_string()));
        let ignored: String = ignored.map(|name| format!("; `{name}` is not read")).collect();
        terminal.print(&format!("the run in {} goes on with its own configuration{ignored}", folder.display()));
    }
    Ok(origin)
}

pub(super) fn json(value: &impl serde::Serialize, terminal: &Terminal) -> Result<(), Failure> {
    terminal.print(&serde_json::to_string_pretty(value).map_err(anyhow::Error::from)?);
    Ok(())
}

/// The validated configuration, or `None` if it was to be printed instead.
pub(super) fn configure(
    args: &ConfigArgs,
    resume: Option<&PathBuf>,
    flags: Vec<Override>,
    terminal: &Terminal,
) -> Result<Option<Settings>, Failure> {
    let settings = args.load(resume, flags)?;
    if args.print_config {
        terminal.print(&args.printed(&settings)?);
        return Ok(None);
    }
    Ok(Some(settings))
}

/// Joins the bus; `None` if `shutdown` comes before a router answers.
pub(super) async fn join_bus(config: &Valid<BusConfig>, shutdown: &CancellationToken) -> Result<Option<Bus>, BusError> {
    tokio::select! {
        () = shutdown.cancelled() => Ok(None),
        bus = Bus::open(config) => bus.map(Some),
    }
}

/// The command that serves the page of these runs.
pub(super) fn serve_command(folders: &[PathBuf]) -> String {
    shell::command("serve", folders.iter().map(|folder| shell::path(folder)))
}

/// Threads that step worlds: as many as requested, or one per core available to this process.
pub(super) fn n_threads(asked: Option<u16>) -> usize {
    let n_cores = || std::thread::available_parallelism().map_or(1, usize::from);
    asked.map_or_else(n_cores, usize::from)
}

/// Says where a run is, and what can be done with it.
pub(super) fn farewell(run_dir: &RunDir, is_complete: bool) -> String {
    // Without a higher step limit, a complete run would stop at once.
    let steps = if is_complete { " --steps N" } else { "" };
    let shown = run_dir.path().display();
    let path = shell::path(run_dir.path());
    let program = program();
    format!(
        "\nsaved in {shown}\n  evaluate it: {program} eval --checkpoint {path}\n  \
         continue it: {program} train --resume {path}{steps}\n  \
         look at it: {program} serve {path}"
    )
}

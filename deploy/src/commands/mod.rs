//! Implementations of the subcommands.

mod best;
mod blueprints;
mod completions;
mod eval;
mod expert;
mod files;
mod goals;
mod in_process;
mod keys;
mod models;
mod names;
mod play;
mod record;
mod render;
mod report;
mod router;
mod serve;
mod services;
mod stage;
mod sweep;
mod train;
mod watch;

pub use self::services::{actor_setup, learner_setup};

use std::path::PathBuf;
use std::time::Duration;

use ::bus::{Bus, BusConfig, BusError};
use tokio_util::sync::CancellationToken;

use crate::cli::{self, Command, ConfigArgs, RunArgs, Settings};
use crate::config::{Override, check_variables};
use crate::exit::Failure;
use crate::limits;
use crate::live::Terminal;
use crate::run_dir::{Origin, check_run};
use crate::{health, shell, signals};

/// Threads for the bus and for services that wait; stepping and training use their own threads.
const N_RUNTIME_THREADS: usize = 2;

/// Time limit for threads outside the runtime to end after everything else has ended. What they still compute or print
/// is of no use to anybody by then.
const LAST_THREADS: Duration = Duration::from_millis(250);

/// Runs a subcommand to completion.
///
/// # Errors
/// The reason for the failure; [`Failure`] lists the kinds.
pub fn execute(command: Command, terminal: &Terminal) -> Result<(), Failure> {
    let names: Vec<String> = std::env::vars_os().map(|(name, _)| name.to_string_lossy().into_owned()).collect();
    check_variables(names.iter().map(String::as_str), &cli::program())?;
    match command {
        Command::Blueprints(command) => blueprints::run(&command, terminal),
        Command::Record(args) => on_runtime(async |shutdown| record::run(&args, terminal, &shutdown)),
        Command::Render(args) if args.live.connect.is_empty() => render::run(&args, terminal),
        Command::Render(args) => on_runtime(async |shutdown| render::run_live(&args, terminal, shutdown).await),
        Command::Completions(args) => {
            completions::completions(&args, terminal);
            Ok(())
        }
        Command::Eval(args) => on_runtime(async |shutdown| eval::run(&args, terminal, &shutdown)),
        Command::Export(args) => models::export(&args, terminal),
        Command::Play(args) => {
            let source = models::Source::of(args.checkpoint.as_deref())?;
            goals::tell_choices(&[&args.ids[..], &args.blueprint[..]].concat(), terminal)?;
            let program = play::Program::of(&args)?;
            let config = play::configure(&source, &program, &args)?;
            on_runtime(async |shutdown| play::run(source, program, &config, &args, terminal, shutdown).await)
        }
        Command::Serve(args) => on_runtime(async |shutdown| serve::run(&args, terminal, shutdown).await),
        Command::Report(args) => report::run(&args, terminal),
        Command::Keys(command) => keys::run(&command, terminal),
        Command::Healthcheck(args) => {
            let state = health::check(&args.file, args.alive)?;
            if let Some(joins) = state.joins {
                terminal.print(&joins.to_string());
            }
            Ok(())
        }
        Command::Router(args) => on_runtime(async |shutdown| router::run(&args, shutdown).await),
        Command::Watch(args) => on_runtime(async |shutdown| watch::run(&args, terminal, shutdown).await),
        Command::Train(args) => {
            let listen =
                (!args.listen.is_empty()).then(|| Override::flag("--listen", "bus.listen", args.listen.clone()));
            let actors = args.actors.map(|n_threads| Override::flag("--actors", "actor.n_threads", n_threads));
            let lockstep = args.lockstep.then(|| Override::flag("--lockstep", "lockstep", true));
            let keys = args.keys.overrides("router").filter(|_| !args.listen.is_empty());
            let given = [listen, actors, lockstep, keys, args.page.overrides()];
            let said = if args.json { terminal.on_stderr() } else { terminal.clone() };
            let origin = origin(&args.run, &args.config, &said)?;
            if let (Some(run), false) = (&origin.checkpoint, args.blueprint.is_empty()) {
                return Err(Failure::Usage(format!(
                    "--blueprint: the run in {} goes on with the goals that it began with; for others, start a run with \
                     `--init-from {} --blueprint …`",
                    run.display(),
                    shell::path(run)
                )));
            }
            goals::tell_choices(&args.blueprint, &said)?;
            let goals = goals::TrainingGoals::open(&args.blueprint, origin.config.as_deref())?;
            let flags = args.run.overrides().into_iter().chain(goals.settings());
            let flags = flags.chain(given.into_iter().flatten()).collect();
            let Some(settings) = configure(&args.config, origin.config.as_ref(), flags, terminal)? else {
                return Ok(());
            };
            on_runtime(async |shutdown| {
                if args.end_with_stdin {
                    signals::cancel_with_stdin(shutdown.clone());
                }
                let summary = train::run(&settings, &args, &goals, origin, &said, shutdown).await?;
                if args.json { json(&summary, terminal) } else { Ok(()) }
            })
        }
        Command::Sweep(args) => on_runtime(async |shutdown| sweep::run(&args, terminal, shutdown).await),
        Command::Actor(args) => {
            let flags = args.endpoints.overrides("actor");
            let Some(settings) = configure(&args.config, None, flags, terminal)? else { return Ok(()) };
            on_runtime(async |shutdown| services::run_actor(&settings, &args, terminal, shutdown).await)
        }
        Command::Learner(args) => {
            let flags = [args.member.endpoints.overrides("learner"), args.run.overrides()].concat();
            let origin = origin(&args.run, &args.member.config, terminal)?;
            let Some(settings) = configure(&args.member.config, origin.config.as_ref(), flags, terminal)? else {
                return Ok(());
            };
            on_runtime(async |shutdown| services::run_learner(&settings, &args, origin, terminal, shutdown).await)
        }
        Command::Evaluator(args) => {
            let flags = args.member.endpoints.overrides("evaluator").into_iter().chain(args.page.overrides()).collect();
            let Some(settings) = configure(&args.member.config, None, flags, terminal)? else { return Ok(()) };
            on_runtime(async |shutdown| services::run_evaluator(&settings, &args, terminal, shutdown).await)
        }
    }
}

/// Where the run starts; prints a note if the given preset or file is ignored, or if there is no checkpoint to resume.
///
/// # Errors
/// When the folder to continue is not that of a run.
fn origin(run: &RunArgs, config: &ConfigArgs, terminal: &Terminal) -> Result<Origin, Failure> {
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

/// Prints a value as JSON.
fn json(value: &impl serde::Serialize, terminal: &Terminal) -> Result<(), Failure> {
    terminal.print(&serde_json::to_string_pretty(value).map_err(anyhow::Error::from)?);
    Ok(())
}

/// The validated configuration, or `None` if it was to be printed instead.
fn configure(
    args: &ConfigArgs,
    resume: Option<&PathBuf>,
    flags: Vec<Override>,
    terminal: &Terminal,
) -> Result<Option<Settings>, Failure> {
    let settings = args.load(resume, flags)?;
    settings.config.validate()?;
    if args.print_config {
        terminal.print(&args.printed(&settings)?);
        return Ok(None);
    }
    Ok(Some(settings))
}

/// Joins the bus; `None` if `shutdown` comes before a router answers.
async fn join_bus(config: &BusConfig, shutdown: &CancellationToken) -> Result<Option<Bus>, BusError> {
    tokio::select! {
        () = shutdown.cancelled() => Ok(None),
        bus = Bus::open(config) => bus.map(Some),
    }
}

/// Runs `command` on a runtime, with a token that the first signal cancels.
///
/// # Errors
/// Those of the command, [`Failure::FewFiles`] if the system allows too few open files, or [`Failure::Service`] if the
/// runtime cannot be started.
pub fn on_runtime(command: impl AsyncFnOnce(CancellationToken) -> Result<(), Failure>) -> Result<(), Failure> {
    limits::allow_many_files()?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(N_RUNTIME_THREADS)
        .enable_all()
        .build()
        .map_err(|error| Failure::Service(error.into()))?;
    let ended = runtime.block_on(async {
        let shutdown = CancellationToken::new();
        signals::cancel_on_signal(shutdown.clone())?;
        command(shutdown).await
    });
    runtime.shutdown_timeout(LAST_THREADS);
    ended
}

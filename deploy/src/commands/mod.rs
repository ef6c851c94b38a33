//! Implementations of the subcommands.

mod best;
mod blueprints;
mod common;
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

use std::time::Duration;

use tokio_util::sync::CancellationToken;

use self::common::{configure, json, origin};
use crate::cli::{self, Command};
use crate::config::{Override, check_variables};
use crate::exit::Failure;
use crate::limits;
use crate::live::Terminal;
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

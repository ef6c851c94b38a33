//! Implementations of the subcommands.

mod best;
mod blueprints;
mod common;
mod completions;
mod eval;
mod files;
mod goals;
mod keys;
mod models;
mod names;
mod play;
mod record;
mod render;
mod report;
mod runtime;
mod serve;
mod services;
mod stage;
mod sweep;
mod train;
mod watch;

pub use self::runtime::on_runtime;
pub use self::services::{actor_setup, learner_setup};

use self::common::{configure, origin};
use crate::cli::{self, Command};
use crate::config::check_variables;
use crate::exit::Failure;
use crate::health;
use crate::live::Terminal;

/// Runs a subcommand to completion.
///
/// # Errors
/// The reason for the failure; [`Failure`] lists the kinds.
pub fn execute(command: Command, terminal: &Terminal) -> Result<(), Failure> {
    let names: Vec<String> = std::env::vars_os().map(|(name, _)| name.to_string_lossy().into_owned()).collect();
    check_variables(names.iter().map(String::as_str), &cli::program())?;
    match command {
        Command::Blueprints(command) => blueprints::run(&command, terminal),
        Command::Record(args) => on_runtime(async |shutdown| record::run(&args, terminal, &shutdown).await),
        Command::Render(args) => render::run(&args, terminal),
        Command::Completions { shell } => {
            completions::completions(shell, terminal);
            Ok(())
        }
        Command::Eval(args) => on_runtime(async |shutdown| eval::run(&args, terminal, &shutdown).await),
        Command::Export(args) => models::export(&args, terminal),
        Command::Play(args) => {
            let source = models::Source::of(args.checkpoint.as_deref())?;
            let named = [&args.ids[..], &args.blueprint[..]].concat();
            let goals = goals::Goals::open_beside(&named, args.checkpoint.as_deref())?;
            goals.tell_choices(terminal);
            let config = play::configure(&source, &args)?;
            on_runtime(async |shutdown| play::run(source, &goals, &config, &args, terminal, shutdown).await)
        }
        Command::Serve(args) => on_runtime(async |shutdown| serve::run(&args, terminal, shutdown).await),
        Command::Report(args) => report::run(&args, terminal),
        Command::Keys(command) => keys::run(&command, terminal),
        Command::Healthcheck { file, alive } => {
            if let Some(joins) = health::check(&file, alive)?.joins {
                terminal.print(&joins.to_string());
            }
            Ok(())
        }
        Command::Router(args) => on_runtime(async |shutdown| services::run_router(&args, shutdown).await),
        Command::Watch(args) => on_runtime(async |shutdown| watch::run(&args, terminal, shutdown).await),
        Command::Train(args) => train::command(&args, terminal),
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

//! What is not shipped. `lab actors` measures how many actors a router and a learner's ingest carry, and `lab generate`
//! writes blueprints.

#![cfg_attr(test, allow(clippy::unwrap_used))]

mod actors;
mod cli;
mod generate;
mod generator;

use std::process::ExitCode;

use clap::Parser;
use deploy::commands::on_runtime;
use deploy::config::check_variables;
use deploy::exit::Failure;
use deploy::live::Terminal;
use deploy::telemetry;

use crate::actors::parts;
use crate::cli::{Cli, Command};

fn main() -> ExitCode {
    let cli = Cli::parse();
    let terminal = Terminal::default();
    telemetry::init(cli.log_format, &terminal);
    match run(&cli.command, &terminal) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let failure = error.downcast::<Failure>().unwrap_or_else(Failure::from);
            terminal.on_stderr().print(&format!("error: {failure}"));
            failure.exit_code()
        }
    }
}

fn run(command: &Command, terminal: &Terminal) -> anyhow::Result<()> {
    let names: Vec<String> = std::env::vars_os().map(|(name, _)| name.to_string_lossy().into_owned()).collect();
    check_variables(names.iter().map(String::as_str), &deploy::cli::program()).map_err(Failure::from)?;
    match command {
        Command::Actors(args) => actors::run(args, terminal)?,
        Command::Generate(args) => generate::run(args, terminal)?,
        Command::Router => on_runtime(async |shutdown| parts::router(shutdown).await)?,
        Command::Ingest => on_runtime(async |shutdown| parts::ingest(shutdown).await)?,
        Command::Load => on_runtime(async |shutdown| parts::load(shutdown).await)?,
    }
    Ok(terminal.check_written()?)
}

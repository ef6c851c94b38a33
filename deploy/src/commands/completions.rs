//! `completions`: shell completions, generated from the definition of the command line.

use clap::CommandFactory;

use crate::cli::{Cli, CompletionsArgs};
use crate::live::Terminal;

/// Prints the completions for a shell.
pub(super) fn completions(args: &CompletionsArgs, terminal: &Terminal) {
    let mut command = Cli::command();
    let name = command.get_name().to_owned();
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut command, name, &mut text);
    terminal.print(&String::from_utf8_lossy(&text));
}

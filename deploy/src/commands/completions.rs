//! `completions` and `man`: shell completions and man pages, generated from the definition of the command line.

use clap::CommandFactory;

use super::files::{File, write_files};
use crate::cli::{Cli, CompletionsArgs, ManArgs};
use crate::exit::Failure;
use crate::live::Terminal;

/// Prints the completions for a shell.
pub(super) fn completions(args: &CompletionsArgs, terminal: &Terminal) {
    let mut command = Cli::command();
    let name = command.get_name().to_owned();
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut command, name, &mut text);
    terminal.print(&String::from_utf8_lossy(&text));
}

/// Writes a page for the program and one for each command: `lodestone-train.1` and so on.
///
/// # Errors
/// When a file cannot be written.
pub(super) fn man(args: &ManArgs, terminal: &Terminal) -> Result<(), Failure> {
    let mut command = Cli::command();
    // Sets the full names of the subcommands.
    command.build();
    let pages = pages(&command)?;
    write_files(&args.dir, &pages)?;
    terminal.print(&format!("{} pages in {}", pages.len(), args.dir.display()));
    Ok(())
}

/// The pages of a command and of its subcommands.
fn pages(command: &clap::Command) -> Result<Vec<File>, Failure> {
    let name = command.get_display_name().unwrap_or_else(|| command.get_name());
    let mut text = Vec::new();
    let page = clap_mangen::Man::new(command.clone().display_name(name.to_owned()));
    page.render(&mut text).map_err(anyhow::Error::from)?;
    let mut pages = vec![(format!("{name}.1"), text)];
    for below in command.get_subcommands().filter(|below| below.get_name() != "help") {
        pages.extend(self::pages(below)?);
    }
    Ok(pages)
}

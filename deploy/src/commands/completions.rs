//! `completions`: shell completions, generated from the definition of the command line and the values that it takes.

use blueprints::{Catalog, Split};
use clap::builder::{PossibleValue, PossibleValuesParser};
use clap::{Arg, Command, CommandFactory, ValueHint};
use clap_complete::Shell;

use crate::cli::Cli;
use crate::config::keys;
use crate::live::Terminal;

pub(super) fn completions(shell: Shell, terminal: &Terminal) {
    let mut command = with_values(Cli::command());
    let name = command.get_name().to_owned();
    let mut text = Vec::new();
    clap_complete::generate(shell, &mut command, &name, &mut text);
    if shell == Shell::Fish {
        // The generator knows only options there.
        for command in command.get_subcommands() {
            let values = command.get_positionals().flat_map(Arg::get_possible_values);
            let values: Vec<String> = values.map(|value| value.get_name().to_owned()).collect();
            let using = format!("__fish_{name}_using_subcommand {}", command.get_name());
            text.extend(format!("complete -c {name} -n '{using}' -a '{}'\n", values.join(" ")).bytes());
        }
    }
    terminal.print(&String::from_utf8_lossy(&text));
}

/// Lists what arguments of these names usually are. The shell alone needs the lists: a value may be anything else.
fn with_values(command: Command) -> Command {
    let command = command.mut_args(|arg| {
        let name = arg.get_value_names().and_then(<[_]>::first).map(ToString::to_string).unwrap_or_default();
        match name.as_str() {
            // The hint keeps bash from putting a space after `=`.
            "KEY=VALUE" | "KEY=V,V" => arg.value_parser(listed(settings())).value_hint(ValueHint::Other),
            "SPLIT" => arg.value_parser(listed(Split::ALL.iter().map(ToString::to_string))),
            "ACTING" => arg.value_parser(listed(["greedy", "sampled"].map(str::to_owned))),
            "FILE|ID" => arg.value_parser(listed(Catalog::builtin().iter().map(|goal| goal.id().to_string()))),
            "RUN" | "RUN2" | "DIR" | "DIR_OR_FILE" | "FILE_OR_RUN" => arg.value_hint(ValueHint::DirPath),
            _ => arg,
        }
    });
    command.mut_subcommands(with_values)
}

/// All keys, each with `=`.
fn settings() -> impl Iterator<Item = String> {
    let mut names: Vec<String> =
        keys().into_iter().filter(|key| !key.is_section()).map(|key| format!("{}=", key.name)).collect();
    // Several variants of a choice may have the same key.
    names.dedup();
    names.into_iter()
}

/// A parser of these values. Its names live as long as the process, which ends after printing them.
fn listed(values: impl IntoIterator<Item = String>) -> PossibleValuesParser {
    let value = |text: String| PossibleValue::new(&*text.leak());
    PossibleValuesParser::new(values.into_iter().map(value))
}

//! The environment variables that begin with the program's name: which exist, and which was meant.

use std::collections::BTreeSet;

use super::layers::{PREFIX, SETTINGS};
use super::{ConfigError, keys, nearest, suggestion_or};

/// Variables of tests, of Compose, and of the scripts for Slurm, which this program does not read.
const OTHERS: [&str; 18] = [
    "CHROMEDRIVER",
    "GOLDEN_DIR",
    "GPU_IMAGE",
    "IMAGE",
    "PROGRAM",
    "PYTHON",
    "SLURM_ACTORS",
    "SLURM_ACTOR_CPUS",
    "SLURM_BINARY",
    "SLURM_EVALUATOR",
    "SLURM_HETJOB",
    "SLURM_HOME",
    "SLURM_INTERFACE",
    "SLURM_LEARNER",
    "SLURM_POLL_S",
    "SLURM_PORTS",
    "SLURM_PROTOCOL",
    "TEST_HISTORY",
];

/// Refuses names that begin with `LODESTONE_` and mean nothing: most are settings with one underscore between section
/// and key, which would be ignored. Names with two are settings, and are checked where the configuration is read. Flags of
/// the `program` may have names too.
///
/// # Errors
/// Names the first such variable in alphabetical order, and the most similar one that exists.
pub fn check_variables<'n>(
    names: impl IntoIterator<Item = &'n str>,
    program: &clap::Command,
) -> Result<(), ConfigError> {
    let ours: BTreeSet<&str> = names.into_iter().filter_map(|name| name.strip_prefix(PREFIX)).collect();
    let known = known(program);
    let means_nothing = |name: &&&str| !name.contains("__") && !known.contains(**name) && !is_service(name);
    let Some(unknown) = ours.iter().find(means_nothing) else { return Ok(()) };
    let settings =
        keys().into_iter().filter(|key| !key.is_section()).map(|key| key.name.to_uppercase().replace('.', "__"));
    let candidates: BTreeSet<String> = known.into_iter().chain(settings).collect();
    let meant = nearest(unknown, candidates.iter().map(String::as_str)).map(|name| format!("{PREFIX}{name}"));
    let rule = "; settings have two underscores between section and key: LODESTONE_LEARNER__GAMMA";
    let suggestion = suggestion_or(&meant, rule);
    Err(ConfigError::at(format_args!("{PREFIX}{unknown}"), format_args!("there is no such variable{suggestion}")))
}

/// All known names without a section.
fn known(program: &clap::Command) -> BTreeSet<String> {
    fn of_flags(command: &clap::Command, found: &mut BTreeSet<String>) {
        let names = command.get_arguments().filter_map(|argument| argument.get_env()?.to_str()?.strip_prefix(PREFIX));
        found.extend(names.map(str::to_owned));
        command.get_subcommands().for_each(|below| of_flags(below, found));
    }
    let mut found: BTreeSet<String> = SETTINGS.iter().chain(&OTHERS).map(|&name| name.to_owned()).collect();
    of_flags(program, &mut found);
    found
}

/// Whether Kubernetes sets a variable of this kind in every container for a service whose name begins like the prefix:
/// `SERVICE_HOST`, `ROUTER_SERVICE_PORT_QUIC`, `PORT`, `ROUTER_PORT_7447_UDP_ADDR`.
fn is_service(name: &str) -> bool {
    let name = format!("_{name}");
    let of_port = name.rsplit_once("_PORT_").map(|(_, rest)| rest.split('_').collect::<Vec<_>>());
    let is_port = |number: &str| number.parse::<u16>().is_ok();
    name.ends_with("_SERVICE_HOST")
        || name.ends_with("_PORT")
        || name.contains("_SERVICE_PORT_")
        || of_port.is_some_and(|parts| matches!(parts[..], [port, "TCP" | "UDP" | "SCTP", ..] if is_port(port)))
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;
    use crate::cli::Cli;

    fn refused(name: &str) -> Option<String> {
        check_variables([name], &Cli::command()).err().map(|error| error.to_string())
    }

    #[test]
    fn a_variable_that_means_nothing_is_named_with_the_one_that_was_meant() {
        for (name, meant) in [
            ("LODESTONE_LEARNER_GAMMA", "LODESTONE_LEARNER__GAMMA"),
            ("LODESTONE_ACTOR_N_WORLDS", "LODESTONE_ACTOR__N_WORLDS"),
            ("LODESTONE_STEP", "LODESTONE_STEPS"),
            ("LODESTONE_PRESETS", "LODESTONE_PRESET"),
            ("LODESTONE_SLURM_HOMES", "LODESTONE_SLURM_HOME"),
        ] {
            let expected = format!("{name}: there is no such variable; did you mean `{meant}`?");
            assert_eq!(refused(name), Some(expected));
        }
        let message = refused("LODESTONE_XYZ").unwrap();
        assert!(message.contains("two underscores between section and key"), "{message}");
    }

    #[test]
    fn flags_settings_scripts_and_kubernetes_keep_their_names() {
        for name in [
            "LODESTONE_STEPS",
            "LODESTONE_RUN",
            "LODESTONE_SEED",
            "LODESTONE_HEALTH_FILE",
            "LODESTONE_LEARNER__GAMMA",
            "LODESTONE_CHROMEDRIVER",
            "LODESTONE_SLURM_POLL_S",
            "LODESTONE_PORT",
            "LODESTONE_PORT_7447_TCP",
            "LODESTONE_PORT_7447_TCP_ADDR",
            "LODESTONE_SERVICE_HOST",
            "LODESTONE_ROUTER_SERVICE_PORT",
            "LODESTONE_ROUTER_SERVICE_PORT_QUIC",
            "LODESTONE_ROUTER_PORT_7447_UDP_PROTO",
            "PATH",
        ] {
            assert_eq!(refused(name), None, "{name}");
        }
    }
}

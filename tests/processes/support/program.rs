//! Runs the program for the tests.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Command, Output, Stdio};

use serde_json::Value;

/// The path of the program.
pub(crate) const LODESTONE: &str = env!("CARGO_BIN_EXE_lodestone");

/// Settings with which a training takes seconds: updates of 256 steps, and a tiny network.
pub(crate) const SMALL: [&str; 5] = [
    "--set=learner.batch_size=256",
    "--set=actor.n_worlds=8",
    "--set=evaluator.episodes.n_episodes=2",
    "--set=policy.network.width=16",
    "--set=policy.network.value_hidden=[16]",
];

/// [`LODESTONE`] as a [`command`].
pub(crate) fn lodestone(folder: &Path) -> Command {
    command(LODESTONE, folder)
}

/// A program in `folder`, without the caller's `LODESTONE_*` variables and `RUST_LOG`.
pub(crate) fn command(program: &str, folder: &Path) -> Command {
    let mut command = Command::new(program);
    for (name, _) in std::env::vars().filter(|(name, _)| name.starts_with("LODESTONE_") || name == "RUST_LOG") {
        command.env_remove(name);
    }
    command.current_dir(folder);
    command
}

/// The program with these arguments, without input and output.
pub(crate) fn quiet(folder: &Path, args: &[&str]) -> Command {
    let mut command = lodestone(folder);
    command.args(args).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    command
}

/// Runs a command that must succeed.
pub(crate) fn finished(command: &mut Command) -> Output {
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}: {}: {said}", output.status);
    output
}

/// Runs a command that must succeed; returns its stdout.
pub(crate) fn printed(command: &mut Command) -> String {
    String::from_utf8(finished(command).stdout).unwrap()
}

/// Runs a command that must succeed; returns the JSON on its stdout.
pub(crate) fn printed_json(command: &mut Command) -> Value {
    serde_json::from_str(&printed(command)).unwrap()
}

/// Runs a command that must end with this code and all of these words on stderr; returns its stderr.
pub(crate) fn refused(command: &mut Command, code: i32, words: &[&str]) -> String {
    let output = command.output().unwrap();
    check_refused(&output, code, words, &format!("{command:?}"))
}

/// Checks how a command ended, as [`refused`] does.
pub(crate) fn check_refused(output: &Output, code: i32, words: &[&str], what: &str) -> String {
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{what}: {said}");
    for word in words {
        assert!(said.contains(word), "{what} does not say {word:?}: {said}");
    }
    said
}

pub(crate) fn lines(stream: impl Read) -> impl Iterator<Item = String> {
    BufReader::new(stream).lines().map(Result::unwrap)
}

/// Sends a signal, such as `-TERM`, to a process.
pub(crate) fn kill(signal: &str, pid: u32) {
    finished(Command::new("kill").args([signal, &pid.to_string()]));
}

pub(crate) fn read_json(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// The lines of a run's metrics.
pub(crate) fn metrics(run_dir: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(run_dir.join("metrics.jsonl")).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Names of the files in a folder, sorted.
pub(crate) fn names(folder: &Path) -> Vec<String> {
    let files = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = files.map(|file| file.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// Environment steps of a run's newest checkpoint.
pub(crate) fn n_saved_steps(run_dir: &Path) -> u64 {
    let names = names(&run_dir.join("checkpoints")).into_iter();
    names.filter_map(|name| name.strip_prefix("step-")?.parse().ok()).max().unwrap()
}

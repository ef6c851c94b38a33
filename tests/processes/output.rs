//! Where the results of commands go if nobody can take them: a full disk is an error, a closed pipe is none.

use std::collections::BTreeSet;
use std::fs::File;
use std::io;
use std::path::Path;
use std::process::{Output, Stdio};

use bus::Bus;
use clap::{Command, CommandFactory};
use deploy::cli::Cli;
use serde_json::Value;

use crate::compatibility::old_run;
use crate::support::program::{check_refused, lodestone, n_saved_steps};
use crate::support::served;

/// Every command whose result is on stdout, with arguments that work beside a folder `run` of a run.
const RESULTS: [&[&str]; 23] = [
    &["--help"],
    &["--version"],
    &["train", "--print-config"],
    &["actor", "--print-config", "--connect", "tcp/127.0.0.1:1"],
    &["learner", "--print-config", "--connect", "tcp/127.0.0.1:1"],
    &["evaluator", "--print-config", "--connect", "tcp/127.0.0.1:1"],
    &["keys", "new", "keys"],
    &["keys", "router", "keys"],
    &["eval", "--pretrained", "--blueprint", "2_000", "--episodes", "1"],
    &["eval", "--pretrained", "--blueprint", "2_000", "--episodes", "1", "--json"],
    &["serve", "run", "--export", "page", "--blueprint", "2_000"],
    &["export", "--checkpoint", "run", "--out", "policy.safetensors"],
    &["report", "run-0.1.0"],
    &["report", "run-0.1.0", "--json", "--out", "plots"],
    &["eval", "--expert", "--blueprint", "2_000", "--episodes", "1"],
    &["record", "--expert", "--blueprint", "2_000", "--out", "played"],
    &["render", "run-0.1.0/replays/2_000/00000000-failure.trajectory", "--format", "png-strip", "--out", "videos"],
    &["blueprints", "list"],
    &["blueprints", "list", "--json"],
    &["blueprints", "check", "goal.toml"],
    &["blueprints", "check", "goal.toml", "--json"],
    &["blueprints", "show", "2_000", "--out", "pictures"],
    &["completions", "bash"],
];

/// Commands without a result on stdout, or tested elsewhere (`sweep`, `watch`).
const OTHERS: [&str; 5] = ["healthcheck", "play", "router", "sweep", "watch"];

/// A folder with a run, one of version 0.1.0, and a blueprint.
fn prepared() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    assert!(served::train(&mut lodestone(folder.path())).args(["--steps", "256"]).status().unwrap().success());
    old_run(folder.path());
    let blocks = "blocks = [{ type = \"3x1x1\", at = [0, 0, 0] }, { type = \"1x1x1\", at = [2, 0, 1] }]";
    std::fs::write(folder.path().join("goal.toml"), blocks).unwrap();
    folder
}

fn run(folder: &Path, args: &[&str], stdout: Stdio) -> Output {
    lodestone(folder).args(args).stdout(stdout).stderr(Stdio::piped()).output().unwrap()
}

/// A device on which every write fails for lack of space.
fn full() -> Stdio {
    File::options().write(true).open("/dev/full").unwrap().into()
}

/// A pipe whose reader is gone.
fn closed() -> Stdio {
    io::pipe().unwrap().1.into()
}

fn check_full(args: &[&str], output: &Output) {
    let words = "error: cannot write to stdout: No space left on device";
    check_refused(output, 1, &[words], &format!("{args:?}"));
}

fn check_closed(args: &[&str], output: &Output) {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{args:?}: {}: {stderr}", output.status);
    assert!(!stderr.contains("error") && !stderr.contains("panic"), "{args:?}: {stderr}");
}

#[test]
fn a_result_that_cannot_be_written_is_an_error() {
    let folder = prepared();
    for args in RESULTS {
        check_full(args, &run(folder.path(), args, full()));
    }
}

#[test]
fn a_reader_that_went_away_is_no_error() {
    let folder = prepared();
    for args in RESULTS {
        check_closed(args, &run(folder.path(), args, closed()));
    }
}

/// The names of all commands below this one that have no commands below them.
fn leaves(command: &Command, before: &str) -> BTreeSet<String> {
    let below = command.get_subcommands().filter(|below| below.get_name() != "help");
    let names = below.flat_map(|below| {
        let name = format!("{before}{}", below.get_name());
        let inside = leaves(below, &format!("{name} "));
        if inside.is_empty() { BTreeSet::from([name]) } else { inside }
    });
    names.collect()
}

#[test]
fn every_command_is_among_these() {
    let all = leaves(&Cli::command(), "");
    let is_named = |name: &&String| {
        let words: Vec<&str> = name.split(' ').collect();
        RESULTS.iter().any(|args| args.starts_with(&words)) || OTHERS.contains(&name.as_str())
    };
    assert_eq!(all.iter().filter(|name| !is_named(name)).collect::<Vec<_>>(), Vec::<&String>::new());
}

#[test]
fn a_training_goes_on_without_a_reader_but_its_summary_is_a_result() {
    let train = |args: &[&str]| {
        let folder = tempfile::tempdir().unwrap();
        let mut command = lodestone(folder.path());
        let command = served::train(&mut command).args(["--steps", "256", "--no-web"]).args(args);
        let output = command.stdout(full()).stderr(Stdio::piped()).output().unwrap();
        assert!(n_saved_steps(&folder.path().join("run")) >= 256, "it was saved");
        output
    };
    let trained = train(&[]);
    assert!(trained.status.success(), "{}", String::from_utf8_lossy(&trained.stderr));
    check_full(&["train", "--json"], &train(&["--json"]));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_watched_is_a_result() {
    let folder = tempfile::tempdir().unwrap();
    let bus = Bus::isolated(folder.path()).await.unwrap();
    let learner: Value = serde_json::from_str(include_str!("../../dashboard/tests/metrics/learner.json")).unwrap();
    let publisher = bus.metrics_publisher("learner").await.unwrap();
    publisher.put(&learner).await.unwrap();
    let endpoint = format!("unixsock-stream/{}", folder.path().join("bus.sock").display());
    for args in [&["--once"][..], &["--once", "--json"], &["--json"]] {
        let args = [&["watch", "--run", "default", "--connect", &endpoint], args].concat();
        for (stdout, check) in [(full(), check_full as fn(&[&str], &Output)), (closed(), check_closed)] {
            let mut command = lodestone(folder.path());
            command.args(&args).stdout(stdout).stderr(Stdio::piped());
            let output = tokio::task::spawn_blocking(move || command.output().unwrap()).await.unwrap();
            check(&args, &output);
        }
    }
    bus.close().await;
}

//! Restarting a run without knowing how it ended.

use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::support::judges::{output_of, python};
use crate::support::program::{finished, lines, lodestone, metrics, n_saved_steps, read_json, refused};
use crate::support::served::Process;

/// The one command that a supervisor would run. Every update is saved, so the run can be killed at any time.
const COMMAND: [&str; 6] = [
    "train",
    "--preset=smoke",
    "--run-dir=run",
    "--auto-resume",
    "--set=learner.checkpoints.every_updates=1",
    "--set=evaluator.evaluate_last=false",
];

fn train(folder: &Path) -> Command {
    let mut command = lodestone(folder);
    command.args(COMMAND).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

/// Starts a training and waits until it has saved `n` times.
fn trained(folder: &Path, n: usize) -> Process {
    let mut training = Process(train(folder).args(["--steps", "1000000000"]).spawn().unwrap());
    let saved = lines(training.0.stderr.as_mut().unwrap()).filter(|line| line.contains("saved"));
    assert_eq!(saved.take(n).count(), n);
    training
}

#[test]
fn one_command_starts_a_run_and_continues_it_after_a_kill() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    drop(trained(folder.path(), 2));
    let first = n_saved_steps(&run);
    drop(trained(folder.path(), 1));
    let second = n_saved_steps(&run);
    assert!(second > first, "{second} after {first}");
    let resumed_from = || read_json(&run.join("meta.json"))["resumed_from"].clone();
    assert_eq!(resumed_from(), "run");

    // A run that already has its steps ends at once, and successfully.
    finished(train(folder.path()).args(["--steps", "1"]));
    // One that was ended before its first checkpoint begins again.
    fs::remove_dir_all(run.join("checkpoints")).unwrap();
    drop(trained(folder.path(), 1));
    assert_eq!(resumed_from(), serde_json::Value::Null);
}

#[test]
fn steps_only_grow_for_readers_of_a_run_that_was_killed() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    drop(trained(folder.path(), 3));
    // As if the kill had come before the newest checkpoint, and in the middle of a line.
    let lost = n_saved_steps(&run);
    fs::remove_dir_all(run.join("checkpoints").join(format!("step-{lost}"))).unwrap();
    let saved = n_saved_steps(&run);
    fs::OpenOptions::new().append(true).open(run.join("metrics.jsonl")).unwrap().write_all(b"{\"key\":").unwrap();
    drop(trained(folder.path(), 2));
    let recorded = metrics(&run);
    let updates = recorded.iter().filter(|line| line["key"] == "learner");
    let steps: Vec<u64> = updates.map(|line| line["n_env_steps"].as_u64().unwrap()).collect();
    assert!(steps.is_sorted_by(|a, b| a < b) && steps.contains(&saved), "{steps:?}, resumed at {saved}");
    let Some(python) = python() else { return };
    let plotted = output_of(&python, "scalars.py", &[&run.join("tb/learner").display().to_string()]);
    let plotted: Vec<u64> =
        plotted["learner/update_s"].as_array().unwrap().iter().map(|point| point[0].as_u64().unwrap()).collect();
    assert!(plotted.is_sorted_by(|a, b| a < b) && plotted.contains(&saved), "{plotted:?}, resumed at {saved}");
}

#[test]
fn a_start_that_is_refused_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let training = trained(folder.path(), 1);
    let files = ["config.toml", "meta.json"].map(|name| folder.path().join("run").join(name));
    let contents =
        || files.each_ref().map(|file| (fs::read(file).unwrap(), fs::metadata(file).unwrap().modified().unwrap()));
    let before = contents();
    for args in [&["train", "--resume", "run", "--seed", "7"][..], &COMMAND] {
        refused(lodestone(folder.path()).args(args), 2, &["another process learns in run"]);
    }
    assert_eq!(contents(), before);

    drop(training);
    let refused = |args: &[&str], code, words: &str| {
        refused(lodestone(folder.path()).arg("train").args(args), code, &[words]);
    };
    // Other goals, another network, and a policy with other inputs than the run that would start from it.
    refused(&["--resume", "run", "--blueprint", "6_005"], 2, "goes on with the goals that it began with");
    refused(&["--resume", "run", "--set", "policy.network.width=16"], 66, "does not fit this learner");
    refused(&["--init-from", "run", "--preset", "quickstart", "--run-dir", "other"], 66, "does not fit");
    assert_eq!(contents(), before);
    assert!(!folder.path().join("other").exists());
    refused(&["--resume", "other"], 66, "other does not exist");
}

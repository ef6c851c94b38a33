//! This version reads what earlier versions wrote: a run's folder with configuration, checkpoint, history, and
//! recordings.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::support::program::{lodestone, n_saved_steps};

/// Copies the run `name` that an earlier version left behind into `folder`.
pub(crate) fn old_run(name: &str, folder: &Path) -> PathBuf {
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/golden").join(name);
    let run = folder.join("run");
    copy(&golden, &run);
    run
}

fn copy(from: &Path, to: &Path) {
    if from.is_dir() {
        fs::create_dir_all(to).unwrap();
        for entry in fs::read_dir(from).unwrap() {
            let name = entry.unwrap().file_name();
            copy(&from.join(&name), &to.join(&name));
        }
    } else {
        fs::copy(from, to).unwrap();
    }
}

/// Stdout of a command, which must succeed.
fn output(folder: &Path, args: &[&str]) -> String {
    let output = lodestone(folder).args(args).output().unwrap();
    let (stdout, stderr) = (String::from_utf8(output.stdout).unwrap(), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{args:?}: {stderr}");
    stdout
}

/// Reports a run, and renders one of its recordings.
fn report_and_render(folder: &Path) {
    output(folder, &["report", "run"]);
    let groups = fs::read_to_string(folder.join("run/report/groups.md")).unwrap();
    assert!(groups.contains("train 2-6"), "{groups}");
    let recording = "run/replays/2_000/00000000-failure.trajectory";
    output(folder, &["render", recording, "--format", "png-strip", "--out", "pictures"]);
}

#[test]
fn the_policy_of_a_run_of_version_0_1_0_is_refused_and_everything_else_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let run = old_run("run-0.1.0", folder.path());
    report_and_render(folder.path());
    for command in [["eval", "--checkpoint", "run"], ["train", "--resume", "run"]] {
        let output = lodestone(folder.path()).args(command).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && stderr.contains("has format version 1"), "{command:?}: {stderr}");
    }
    assert_eq!(n_saved_steps(&run), 256);
}

#[test]
fn a_run_of_format_version_2_is_continued_evaluated_and_reported() {
    let folder = tempfile::tempdir().unwrap();
    let run = old_run("run-format-2", folder.path());
    report_and_render(folder.path());
    let table = output(folder.path(), &["eval", "--checkpoint", "run", "--episodes", "1"]);
    assert!(table.contains("2_000"), "{table}");

    assert_eq!(n_saved_steps(&run), 256);
    output(folder.path(), &["train", "--resume", "run", "--steps", "512"]);
    assert_eq!(n_saved_steps(&run), 512);
    let lines = fs::read_to_string(run.join("metrics.jsonl")).unwrap();
    let learner = lines.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    let updates: Vec<u64> = learner.filter_map(|line| line["n_updates"].as_u64()).collect();
    assert_eq!(updates, [2]);
}

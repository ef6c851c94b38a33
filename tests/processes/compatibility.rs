//! This version reads what an earlier version wrote: a run's folder with configuration, checkpoint, history, and
//! recordings.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::support::program::{lodestone, n_saved_steps};

/// Copies the run that the program of version 0.1.0 left behind into `folder`.
fn old_run(folder: &Path) -> PathBuf {
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/golden/run-0.1.0");
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

#[test]
fn a_run_of_version_0_1_0_is_continued_evaluated_and_reported() {
    let folder = tempfile::tempdir().unwrap();
    let run = old_run(folder.path());
    output(folder.path(), &["report", "run"]);
    let groups = fs::read_to_string(run.join("report/groups.md")).unwrap();
    assert!(groups.contains("train 2-6"), "{groups}");
    let table = output(folder.path(), &["eval", "--checkpoint", "run", "--episodes", "1"]);
    assert!(table.contains("2_000"), "{table}");
    let recording = "run/replays/2_000/00000000-failure.trajectory";
    output(folder.path(), &["render", recording, "--format", "png-strip", "--out", "pictures"]);

    assert_eq!(n_saved_steps(&run), 256);
    output(folder.path(), &["train", "--resume", "run", "--steps", "512"]);
    assert_eq!(n_saved_steps(&run), 512);
    let lines = fs::read_to_string(run.join("metrics.jsonl")).unwrap();
    let learner = lines.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    let updates: Vec<u64> = learner.filter_map(|line| line["n_updates"].as_u64()).collect();
    assert_eq!(updates, [2]);
}

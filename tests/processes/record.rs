//! Recorded episodes: datasets for offline learning, and trajectories for `render`.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::{Value, json};

use crate::support::program::lodestone;

const DATA: &str = "sets/lodestone/expert-v0/data";

fn metadata(folder: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(folder.join("metadata.json")).unwrap()).unwrap()
}

#[test]
fn a_dataset_has_the_episodes_that_were_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let wanted = ["record", "--expert", "--blueprint", "2_000", "--blueprint", "3_000", "--episodes", "2"];
    let record = || lodestone(folder.path()).args(wanted).args(["--out", "sets", "--seed", "3"]).output().unwrap();
    let output = record();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(said.starts_with("4 episodes, ") && said.contains("load_dataset(\"lodestone/expert-v0\")"), "{said}");
    let data = folder.path().join(DATA);
    let head = metadata(&data);
    assert_eq!((&head["total_episodes"], &head["algorithm_name"]), (&json!(4), &json!("expert")));
    let blueprints = (0..4).map(|number| metadata(&data.join(number.to_string()))["options"]["blueprint"].clone());
    assert_eq!(blueprints.collect::<Vec<_>>(), ["2_000", "3_000", "2_000", "3_000"]);

    let again = record();
    let stderr = String::from_utf8(again.stderr).unwrap();
    assert_eq!(again.status.code(), Some(64), "{stderr}");
    assert!(stderr.contains("sets/lodestone/expert-v0 exists already"), "{stderr}");
    assert_eq!(metadata(&data), head);
}

#[test]
fn an_interrupted_recording_is_a_dataset_of_whole_episodes() {
    let folder = tempfile::tempdir().unwrap();
    let mut recording = lodestone(folder.path());
    recording.args(["record", "--expert", "--blueprint", "2_000", "--episodes", "10000", "--out", "sets"]);
    recording.env("RUST_LOG", "lodestone=debug,deploy=debug").stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut recording = recording.spawn().unwrap();
    let mut lines = BufReader::new(recording.stderr.take().unwrap()).lines().map(Result::unwrap);
    assert!(lines.any(|line| line.contains("an episode was kept")));
    let told = Command::new("kill").args(["-INT", &recording.id().to_string()]).status().unwrap();
    assert!(told.success());
    let rest: Vec<String> = lines.collect();
    assert_eq!(recording.wait().unwrap().code(), Some(130), "{rest:?}");
    let data = folder.path().join(DATA);
    let head = metadata(&data);
    let n_episodes = head["total_episodes"].as_u64().unwrap();
    assert!((1..10_000).contains(&n_episodes), "{n_episodes}");
    let n_steps: u64 =
        (0..n_episodes).map(|number| metadata(&data.join(number.to_string()))["total_steps"].as_u64().unwrap()).sum();
    assert_eq!(head["total_steps"], json!(n_steps));
    assert!(!data.join(n_episodes.to_string()).exists());
}

#[test]
fn trajectories_can_be_shown() {
    let folder = tempfile::tempdir().unwrap();
    let wanted = ["record", "--expert", "--blueprint", "2_000", "--episodes", "2", "--format", "trajectory"];
    let record = || lodestone(folder.path()).args(wanted).args(["--out", "played"]).output().unwrap();
    assert!(record().status.success());
    let files = ["played/00000-2_000.trajectory", "played/00001-2_000.trajectory"];
    let shown = ["--format", "png-strip", "--out", "shown"];
    let render = lodestone(folder.path()).arg("render").args(files).args(shown).output().unwrap();
    assert!(render.status.success(), "{}", String::from_utf8_lossy(&render.stderr));
    assert!(folder.path().join("shown/00001-2_000.png").is_file());
    assert_eq!(record().status.code(), Some(64));
}

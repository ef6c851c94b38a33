//! Videos of a training, of its recordings, and of what a network attends to.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Output, Stdio};

use learner::read_model;

use crate::support::judges::{output_of, python};
use crate::support::program::{SMALL, finished, kill, lines, lodestone, refused};
use crate::support::served::{Process, page};

/// A goal that an untrained policy builds in some episodes.
const EVALUATED: [&str; 3] = [
    "--set=evaluator.selection.blueprints=[\"2_000\"]",
    "--set=evaluator.selection.sizes=[2,2]",
    "--set=evaluator.episodes.n_episodes=4",
];

/// All files below a folder, sorted.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries: Vec<PathBuf> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    let below = |path: PathBuf| if path.is_dir() { files(&path) } else { vec![path] };
    let mut all: Vec<PathBuf> = entries.into_iter().flat_map(below).collect();
    all.sort();
    all
}

/// Number of steps of a video's episode, as the program prints it.
fn n_steps(printed: &Output, name: &str) -> u64 {
    let text = String::from_utf8_lossy(&printed.stdout);
    let line = text.lines().find(|line| line.contains(name)).unwrap_or_else(|| panic!("no {name} in {text}"));
    line.rsplit(": ").next().unwrap().split(' ').next().unwrap().parse().unwrap()
}

#[test]
fn a_training_is_recorded_while_it_runs_and_can_be_shown_again() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let mut training = lodestone(folder.path());
    training.args(["train", "--preset", "smoke", "--run-dir", "run", "--steps", "1000000000"]);
    training.args(SMALL).args(EVALUATED).env("RUST_LOG", "evaluator=debug");
    let mut training = Process(training.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap());
    let mut lines = lines(training.0.stderr.take().unwrap());
    let is_recorded = lines.any(|line| line.contains("a video of an evaluation"));
    assert!(is_recorded, "the first pass has an end, whatever it is");
    // A full pipe would block the program, so keep reading its log.
    let rest = std::thread::spawn(move || lines.count());

    kill("-TERM", training.0.id());
    assert!(training.0.wait().unwrap().success());
    rest.join().unwrap();
    let replays = files(&run.join("replays"));
    let shown = finished(lodestone(folder.path()).args(["render", "run", "--out", "videos", "--fps", "10"]));
    let videos = files(&folder.path().join("videos"));
    assert_eq!(videos.len(), replays.len());
    let stem = videos[0].file_stem().unwrap().to_str().unwrap().to_owned();
    let with_weights = ["render", "run", "--out", "seen", "--format", "png-strip", "--attention", "run"];
    finished(lodestone(folder.path()).args(with_weights));
    assert!(fs::read(folder.path().join(format!("seen/{stem}-attention.png"))).unwrap().starts_with(b"\x89PNG"));

    // An exported policy works like its run, including in `play`.
    let export = ["export", "--checkpoint", "run", "--out", "policy.safetensors"];
    finished(lodestone(folder.path()).args(export));
    refused(lodestone(folder.path()).args(export), 64, &["choose another --out"]);
    let both = ["export", "--checkpoint", "run", "--checkpoint", "policy.safetensors", "--out", "mean.safetensors"];
    finished(lodestone(folder.path()).args(both));
    let policy = read_model(&folder.path().join("policy.safetensors")).unwrap();
    assert_eq!(read_model(&folder.path().join("mean.safetensors")).unwrap(), policy);
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/pretrained/model.safetensors");
    let odd = ["export", "--checkpoint", "run", "--checkpoint", shipped, "--out", "none.safetensors"];
    refused(lodestone(folder.path()).args(odd), 64, &["run and ", "model.safetensors", "they have no mean"]);
    let play = ["play", "--checkpoint", "policy.safetensors", "2_001"];
    let (playing, _, _) = page(lodestone(folder.path()).args(play));
    drop(playing);

    let Some(python) = python() else { return };
    // 960 × 540 by default. A tenth of a second for every step and for the first scene, and 2 s for the last scene.
    let properties = output_of(&python, "frames.py", &[&videos[0].display().to_string()]);
    let expected = n_steps(&shown, &stem) + 1 + 20;
    assert_eq!(properties, serde_json::json!({ "n_frames": expected, "size": [960, 540], "fps": 10.0 }));
    let made = files(&run.join("videos"));
    let properties = output_of(&python, "frames.py", &[&made[0].display().to_string()]);
    assert_eq!((&properties["size"], &properties["fps"]), (&serde_json::json!([640, 360]), &serde_json::json!(20.0)));
}

#[test]
fn what_cannot_be_shown_is_said() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir_all(folder.path().join("empty/replays")).unwrap();
    fs::create_dir(folder.path().join("other")).unwrap();
    for (args, code, words) in [
        (&["render", "empty", "--out", "videos"][..], 66, "no recordings yet"),
        (&["render", "other", "--out", "videos"], 66, "no folder of a run"),
        (&["render", "empty", "--out", "videos", "--attention", "gone"], 66, "gone"),
        (&["render", "--out", "videos"], 2, "<FILE_OR_RUN>"),
    ] {
        refused(lodestone(folder.path()).args(args), code, &[words]);
    }
}

//! A training with the real program: it learns, saves, can be evaluated and resumed, and shuts down gracefully on a
//! signal.

use std::path::Path;
use std::process::{Command, Stdio};

use crate::support::program::{
    LODESTONE, SMALL, command, finished, kill, lines, lodestone, n_saved_steps, printed_json, refused,
};

/// Every update is saved, and one goal evaluated.
const SAVED: [&str; 2] =
    ["--set=learner.checkpoints.every_updates=1", "--set=evaluator.selection.blueprints=[\"2_000\"]"];

/// A small training in the folder `run`.
fn train(folder: &Path, args: &[&str]) -> Command {
    let mut command = lodestone(folder);
    command.args(["train", "--run-dir", "run"]).args(SMALL).args(SAVED).args(args);
    command
}

#[test]
fn a_run_is_saved_evaluated_and_continued() {
    let folder = tempfile::tempdir().unwrap();
    let run_dir = folder.path().join("run");
    let trained = finished(&mut train(folder.path(), &["--steps", "512"]));
    assert!(String::from_utf8_lossy(&trained.stdout).contains("eval --checkpoint run"));
    let n_steps = n_saved_steps(&run_dir);
    assert!(n_steps >= 512, "{n_steps}");
    for file in ["config.toml", "meta.json", "metrics.jsonl", "eval.db"] {
        assert!(run_dir.join(file).is_file(), "{file}");
    }
    let evaluations = runlog::History::read(&runlog::RunPaths::new(&run_dir).history()).unwrap();
    assert_eq!(evaluations.last().unwrap().n_env_steps, n_steps, "the last weights were evaluated as well");

    let eval = ["eval", "--checkpoint", "run/checkpoints", "--episodes", "2", "--json"];
    let sampled = ["--set", "evaluator.episodes.acting=[\"sampled\"]"];
    let report = printed_json(lodestone(folder.path()).args(eval).args(sampled));
    assert!(report["summary"]["elapsed_s"].as_f64().unwrap() > 0.0);
    assert_eq!(report["summary"]["n_env_steps"], n_steps);
    let n_episodes = |acting: &str| report["summary"]["all"][acting]["success"]["n_episodes"].as_u64();
    assert_eq!((n_episodes("sampled"), n_episodes("greedy")), (Some(2), Some(0)));

    let goal = (n_steps + 256).to_string();
    let resumed = finished(lodestone(folder.path()).args(["train", "--resume", "run", "--steps", &goal, "--json"]));
    let summary: serde_json::Value = serde_json::from_slice(&resumed.stdout).unwrap();
    assert_eq!((summary["run_dir"].as_str(), summary["is_complete"].as_bool()), (Some("run"), Some(true)));
    assert_eq!(summary["n_env_steps"], n_saved_steps(&run_dir));
    assert_eq!(summary["evaluation"]["n_env_steps"], summary["n_env_steps"]);
    assert!(String::from_utf8_lossy(&resumed.stderr).contains("continuing `quickstart`"));
    assert!(n_saved_steps(&run_dir) >= n_steps + 256);
    let n_steps_of = |update: &serde_json::Value| update["n_env_steps"].as_u64().unwrap();
    let (updates, _) = runlog::lines(&runlog::RunPaths::new(&run_dir), "learner", n_steps_of).unwrap();
    let last = updates.last().unwrap();
    let seconds = |key: &str| last[key].as_f64().unwrap();
    assert!(seconds("run_elapsed_s") > seconds("elapsed_s"), "the time before the resume counts: {last}");

    // A run is not overwritten.
    refused(lodestone(folder.path()).args(["train", "--run-dir", "run"]), 2, &[]);
}

#[test]
fn in_lockstep_a_resumed_run_goes_on_bit_by_bit() {
    let folder = tempfile::tempdir().unwrap();
    // Every update is saved, so the uninterrupted and the interrupted run start new episodes at the same points. The cut is
    // after one whole update: the last of several takes what is left of the steps that were asked for.
    for (run, steps) in [("whole", "1024"), ("cut", "256")] {
        let train = ["train", "--lockstep", "--run-dir", run, "--steps", steps];
        finished(lodestone(folder.path()).args(train).args(SMALL).args(SAVED));
    }
    finished(lodestone(folder.path()).args(["train", "--lockstep", "--resume", "cut", "--steps", "1024"]));
    let newest = |run: &str| {
        folder.path().join(run).join(format!("checkpoints/step-{}", n_saved_steps(&folder.path().join(run))))
    };
    for file in ["parameters.safetensors", "adam.safetensors"] {
        let bytes = |run| std::fs::read(newest(run).join(file)).unwrap();
        assert!(bytes("whole") == bytes("cut"), "{file}");
    }
}

/// Starts a training, sends it the signal once it learns, and returns whether it ended well and the steps it saved.
fn signaled(signal: &str) -> (bool, u64) {
    let folder = tempfile::tempdir().unwrap();
    // The tests may run under `nohup`, which their children would inherit.
    let mut training = command("env", folder.path());
    training.args(["--default-signal=HUP", LODESTONE, "train", "--run-dir", "run"]).args(SMALL).args(SAVED);
    let mut child = training.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let mut lines = lines(child.stdout.take().unwrap());
    // The learner's first line means that everything is running and has learned.
    assert!(lines.any(|line| line.contains("steps/s")));
    kill(signal, child.id());
    lines.for_each(drop);
    (child.wait().unwrap().success(), n_saved_steps(&folder.path().join("run")))
}

#[test]
fn a_signal_drains_and_saves() {
    // Ctrl-C, what supervisors send, and what a terminal that is closed sends.
    for signal in ["-INT", "-TERM", "-HUP"] {
        let (ended_well, n_steps) = signaled(signal);
        assert!(ended_well && n_steps >= 256, "{signal}: {n_steps} steps saved");
    }
}

#[test]
fn a_signal_drains_and_saves_though_nobody_reads_what_is_said() {
    let folder = tempfile::tempdir().unwrap();
    // One that misses the signal is ended later, and that is no success.
    let mut training = command("timeout", folder.path());
    training.args(["--foreground", "300", LODESTONE, "train", "--run-dir", "run", "--steps", "1000000000"]);
    training.args(SMALL).args(SAVED);
    let mut child = training.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stderr.take());
    assert!(lines(child.stdout.take().unwrap()).any(|line| line.contains("steps/s")));
    kill("-TERM", child.id());
    assert!(child.wait().unwrap().success());
    assert!(n_saved_steps(&folder.path().join("run")) >= 256);
}

#[test]
fn a_start_that_fails_leaves_no_run_behind() {
    let folder = tempfile::tempdir().unwrap();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("tcp/{}", taken.local_addr().unwrap());
    let args = ["train", "--run-dir", "run", "--listen", &endpoint];
    let stderr = refused(lodestone(folder.path()).args(args), 65, &[&endpoint, "Address already in use"]);
    assert!(!stderr.contains(".rs:"), "the error names places in code: {stderr}");
    assert!(!folder.path().join("run").exists());
}

#[test]
fn training_that_diverges_stops_and_keeps_usable_weights() {
    let folder = tempfile::tempdir().unwrap();
    let diverge = [
        "--set=learner.optimizer.lr_schedule.kind=fixed",
        "--set=learner.optimizer.learning_rate=100000",
        "--set=learner.batch_size=256",
        "--set=evaluator.episodes.n_episodes=2",
    ];
    let mut train = lodestone(folder.path());
    train.args(["train", "--preset", "smoke", "--run-dir", "run", "--steps", "9000"]).args(diverge);
    let said = refused(&mut train, 67, &["training has diverged: 3 updates in a row"]);
    let run = folder.path().join("run");
    assert!(said.contains(&format!("step-{}", n_saved_steps(&run))), "{said}");
    finished(lodestone(folder.path()).args(["eval", "--checkpoint", "run", "--episodes", "1"]));

    // With another rate, the run goes on from there.
    let n_steps = (n_saved_steps(&run) + 256).to_string();
    let resume = ["train", "--resume", "run", "--steps", &n_steps, "--set", "learner.optimizer.learning_rate=1e-3"];
    finished(lodestone(folder.path()).args(resume));
    assert!(n_saved_steps(&run) >= n_steps.parse().unwrap());
}

#[test]
fn weights_with_which_no_policy_can_act_are_refused_wherever_they_are_read() {
    let folder = tempfile::tempdir().unwrap();
    finished(&mut train(folder.path(), &["--steps", "256"]));
    // Earlier versions saved such weights.
    let checkpoints = folder.path().join("run/checkpoints");
    let mut checkpoint = learner::Checkpoint::read_latest(&checkpoints).unwrap().checkpoint;
    checkpoint.parameters.fill(1e30);
    std::fs::remove_dir_all(&checkpoints).unwrap();
    checkpoint.write(&checkpoints).unwrap();
    for args in [
        &["eval", "--checkpoint", "run"][..],
        &["play", "--checkpoint", "run"],
        &["serve", "run"],
        &["record", "--checkpoint", "run", "--split", "train", "--out", "out"],
        &["export", "--checkpoint", "run", "--out", "out"],
        &["train", "--resume", "run"],
        &["train", "--init-from", "run", "--run-dir", "out"],
        &["learner", "--resume", "run", "--connect", "tcp/127.0.0.1:1"],
    ] {
        refused(lodestone(folder.path()).args(args), 66, &["for a scene, must be a number in"]);
        assert!(!folder.path().join("out").exists(), "{args:?}");
    }
}

//! A sweep: it trains its points, survives its end at any time, and compares what there is.

use std::fs::{self, File};
use std::path::Path;
use std::process::{Command, Stdio};

use crate::support::program::{SMALL, check_refused, kill, lines, lodestone, printed, refused};
use crate::support::served::{Process, interrupt};

/// What the runs are evaluated on.
const EVALUATED: [&str; 3] = [
    "--set=evaluator.selection.blueprints=[\"2_000\",\"2_001\"]",
    "--set=evaluator.episodes.acting=[\"greedy\"]",
    "--set=evaluator.videos.groups=[]",
];

fn sweep(folder: &Path, args: &[&str]) -> Command {
    let mut command = lodestone(folder);
    command.args(["sweep", "--out", "s", "--steps", "1024"]).args(args).args(SMALL).args(EVALUATED);
    command
}

/// The process that this one has started.
fn child(parent: &Process) -> u32 {
    let threads = fs::read_dir(format!("/proc/{}/task", parent.0.id())).unwrap();
    let children = threads.map(|thread| fs::read_to_string(thread.unwrap().path().join("children")).unwrap());
    children.collect::<String>().trim().parse().unwrap()
}

/// Waits until the sweep says this of a run.
fn see(mut lines: impl Iterator<Item = String>, run: &str, what: &str) {
    assert!(lines.any(|line| line.starts_with(run) && line.contains(what)), "{run} {what}");
}

/// The rows and the notes below them.
fn table(printed: &str) -> &str {
    &printed[printed.find("| point |").unwrap_or_else(|| panic!("no table in {printed}"))..]
}

#[test]
fn a_sweep_that_is_killed_and_interrupted_goes_on_with_what_is_not_finished() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["--grid", "learner.gamma=0.9,0.95", "--seeds", "2"];
    let begin = || {
        let mut command = sweep(folder.path(), &args);
        let mut running = Process(command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap());
        let lines = lines(running.0.stdout.take().unwrap());
        (running, lines)
    };
    // Runs wait for this lock before they train.
    let held = |run: &str| {
        let run = folder.path().join("s").join(run);
        fs::create_dir_all(&run).unwrap();
        let metrics = File::create(run.join("metrics.jsonl")).unwrap();
        metrics.lock().unwrap();
        metrics
    };
    let [second, third] = ["point-2/seed-1", "point-1/seed-2"].map(held);
    let (mut killed, mut lines) = begin();
    see(&mut lines, "[1/4] learner.gamma=0.9, seed 1", ": done");
    see(&mut lines, "[2/4] learner.gamma=0.95, seed 1", ": training in");
    // On a busy machine, what it started may live on for a while before it notices.
    let orphan = child(&killed);
    kill("-STOP", orphan);
    killed.0.kill().unwrap();
    killed.0.wait().unwrap();

    let (mut interrupted, mut lines) = begin();
    see(&mut lines, "[2/4] ", ": waiting for the process that trains it");
    kill("-CONT", orphan);
    drop(second);
    see(&mut lines, "[2/4] ", ": done");
    see(&mut lines, "[3/4] learner.gamma=0.9, seed 2", ": training in");
    interrupt(&interrupted);
    assert!(crate::support::program::lines(interrupted.0.stderr.take().unwrap()).any(|line| line.contains("stopping")));
    drop(third);
    let rest: Vec<String> = lines.collect();
    assert!(interrupted.0.wait().unwrap().success());
    assert!(rest.iter().any(|line| line.starts_with("[3/4]") && line.contains("interrupted")), "{rest:?}");
    assert!(rest.iter().any(|line| line.starts_with("2 runs are not finished; go on with")), "{rest:?}");

    let all = printed(&mut sweep(folder.path(), &args));
    let trained: Vec<&str> = all.lines().filter(|line| line.contains(": training in")).map(|line| &line[..5]).collect();
    assert_eq!(trained, ["[3/4]", "[4/4]"], "{all}");
    for gamma in ["0.9", "0.95"] {
        let row = format!("| learner.gamma={gamma} | greedy | 2 | ");
        assert!(table(&all).contains(&row), "{all}");
    }
    assert!(all.contains("| point | actions | seeds | train 2-6 (2) |") && all.ends_with(" serve s\n"), "{all}");

    // Nothing is left to train.
    for mut again in [sweep(folder.path(), &args), lodestone(folder.path())] {
        if again.get_args().next().is_none() {
            again.args(["sweep", "s"]);
        }
        let again = printed(&mut again);
        assert_eq!((table(&again), again.contains("training in")), (table(&all), false), "{again}");
    }
    let other = ["--grid", "learner.gamma=0.9"];
    refused(&mut sweep(folder.path(), &other), 2, &["s holds another sweep, with the seeds [1, 2]"]);
}

#[test]
fn a_point_that_fails_is_named_with_its_log_and_the_others_go_on() {
    let folder = tempfile::tempdir().unwrap();
    let ended = sweep(folder.path(), &["--grid", "device=gpu,cpu", "--jobs", "2", "--json"]).output().unwrap();
    let failed = "device=gpu, seed 1: failed (exit status: 64); see s/point-1/seed-1.log";
    check_refused(&ended, 1, &[failed, "1 of 2 runs failed"], "sweep");
    assert!(fs::read_to_string(folder.path().join("s/point-1/seed-1.log")).unwrap().contains("no GPU backend"));
    let table: serde_json::Value = serde_json::from_slice(&ended.stdout).unwrap();
    let [gpu, cpu] = [&table["points"][0], &table["points"][1]];
    assert_eq!((&gpu["failed"][0]["log"], &gpu["n_done"]), (&"s/point-1/seed-1.log".into(), &0.into()));
    assert_eq!((cpu["failed"].as_array().unwrap().len(), &cpu["n_done"]), (0, &1.into()));
    assert_eq!((&cpu["groups"][0]["group"], &cpu["groups"][0]["n_goals"]), (&"train 2-6".into(), &2.into()));
    let curve = cpu["curve"].as_array().unwrap();
    assert_eq!(curve.last().unwrap()["groups"], cpu["groups"], "a curve ends with the table");

    refused(&mut sweep(folder.path(), &["--grid", "learner.gama=0.9"]), 64, &["gamma"]);
    // What Slurm would run.
    assert_eq!(printed(lodestone(folder.path()).args(["sweep", "s", "--only", "1"])), "");
}

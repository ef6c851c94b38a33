//! Router, learner, actors, and evaluator as separate processes over TCP, killed and replaced while they work.

use std::ffi::OsStr;
use std::net::TcpListener;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::support::judges::{output_of, output_of_script, python};
use crate::support::program::{kill, lines, lodestone, metrics, n_saved_steps, printed_json, quiet};
use crate::support::served::Process;

/// The task of CI's learning test, saved often enough that a process can be killed at any time, and evaluated from the
/// first update on.
const TASK: [&str; 6] =
    ["--preset", "smoke", "--set", "learner.checkpoints.every_updates=2", "--set", "evaluator.every={versions=1}"];

/// Environment steps that are more than enough to learn the task.
const ENOUGH_STEPS: u64 = 200_000;

/// How often to try to start a router.
const ROUTER_STARTS: usize = 10;

struct Cluster {
    folder: tempfile::TempDir,
    endpoint: String,
    _router: Process,
}

impl Cluster {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let start = |_| {
            // This port was free a moment ago. If another process has taken it, the router ends.
            let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
            let endpoint = format!("tcp/127.0.0.1:{port}");
            let mut router = quiet(folder.path(), &["router", "--listen", &endpoint]);
            let mut router = Process(router.stderr(Stdio::piped()).spawn().unwrap());
            let is_there = lines(router.0.stderr.take().unwrap()).any(|line| line.contains("routing"));
            is_there.then_some((endpoint, router))
        };
        let (endpoint, router) = (0..ROUTER_STARTS).find_map(start).expect("no router found its port free");
        Self { folder, endpoint, _router: router }
    }

    fn member(&self, role: &str, args: &[&str]) -> Process {
        let mut command = quiet(self.folder.path(), &[role, "--connect", &self.endpoint]);
        command.args(args);
        if !args.contains(&"--resume") {
            command.args(TASK);
        }
        if role == "evaluator" {
            command.stdout(Stdio::piped());
        }
        Process(command.spawn().unwrap())
    }

    /// Runs a learner until it has consumed `n_steps`; returns the steps of the newest checkpoint.
    fn learn(&self, source: [&str; 2], n_steps: u64) -> u64 {
        let steps = n_steps.to_string();
        let mut learner = self.member("learner", &[source[0], source[1], "--steps", &steps]);
        let status = learner.0.wait().unwrap();
        assert!(status.success(), "{status}");
        let saved = self.n_saved_steps();
        assert!(saved >= n_steps, "{saved} of {n_steps}");
        saved
    }

    /// Success rate of the newest checkpoint with greedy actions, from starts near the goal.
    fn success_rate(&self) -> f64 {
        let report = printed_json(lodestone(self.folder.path()).args(["eval", "--checkpoint", "run", "--json"]));
        report["summary"]["all"]["greedy"]["success"]["rate"].as_f64().unwrap()
    }

    fn n_saved_steps(&self) -> u64 {
        n_saved_steps(&self.folder.path().join("run"))
    }
}

#[test]
fn a_run_reaches_its_goal_though_actors_come_and_go_and_the_learner_is_killed() {
    let cluster = Cluster::start();
    let mut first = cluster.member("actor", &["--id", "first"]);
    let _second = cluster.member("actor", &["--id", "second"]);
    let mut evaluator = cluster.member("evaluator", &["--run-dir", "evaluated"]);
    let saved = cluster.learn(["--run-dir", "run"], 2048);
    let untrained = cluster.success_rate();

    // `kill` sends SIGKILL, so the actor cannot leave cleanly.
    first.0.kill().unwrap();
    first.0.wait().unwrap();
    let _late = cluster.member("actor", &["--id", "late"]);
    let saved = cluster.learn(["--resume", "run"], saved + 2048);

    // A learner without a step limit, killed after it has saved twice.
    let resume = ["learner", "--connect", &cluster.endpoint, "--resume", "run", "--steps", "1000000000"];
    let endless = quiet(cluster.folder.path(), &resume).stderr(Stdio::piped()).spawn();
    let mut endless = Process(endless.unwrap());
    let said = lines(endless.0.stderr.take().unwrap());
    assert_eq!(said.filter(|line| line.contains("saved")).take(2).count(), 2);
    endless.0.kill().unwrap();
    endless.0.wait().unwrap();
    let before = cluster.n_saved_steps();
    assert!(before >= saved + 2048, "{before}");
    // How much is learned per step depends on how the machine schedules the processes, so allow more steps if needed.
    let mut n_steps = before.max(ENOUGH_STEPS);
    cluster.learn(["--resume", "run"], n_steps);
    let mut trained = cluster.success_rate();
    while trained < 0.9 && n_steps < before + 3 * ENOUGH_STEPS {
        n_steps += ENOUGH_STEPS / 2;
        cluster.learn(["--resume", "run"], n_steps);
        trained = cluster.success_rate();
    }
    assert!(untrained < 0.5 && trained >= 0.9, "{untrained} before, {trained} after");
    // The evaluator writes its history before it prints the first line of a report.
    let mut printed = lines(evaluator.0.stdout.take().unwrap());
    assert!(printed.any(|line| line.starts_with("weights")), "the evaluator printed no report");
    assert!(cluster.folder.path().join("evaluated/metrics.jsonl").is_file());
}

#[test]
fn programs_that_share_no_code_with_us_find_what_was_recorded() {
    let Some(python) = python() else { return };
    let cluster = Cluster::start();
    let _actor = cluster.member("actor", &[]);
    let _evaluator = cluster.member("evaluator", &["--run-dir", "evaluated"]);
    let saved = cluster.learn(["--run-dir", "run"], 2048);
    check_readers(&python, &cluster);
    check_trackers(&python, &cluster, saved);
}

/// Checks that readers find the numbers that were recorded.
fn check_readers(python: &OsStr, cluster: &Cluster) {
    let summary = output_of(python, "success.py", &[&cluster.endpoint, "--run", "smoke", "--once"]);
    let record = |key: &str, run: &str, is_same: &dyn Fn(&serde_json::Value) -> bool| {
        let mut recorded = metrics(&cluster.folder.path().join(run)).into_iter();
        let mut same = recorded.find(|line| line["key"] == key && is_same(line)).unwrap();
        same.as_object_mut().unwrap().remove("key");
        same
    };
    let version = |line: &serde_json::Value| line["weights_version"] == summary["weights_version"];
    assert_eq!(summary, record("eval/summary", "evaluated", &version));
    assert!(summary["all"]["greedy"]["success"]["n_episodes"].as_u64().unwrap() > 0);

    let history = output_of(python, "success.py", &[&cluster.endpoint, "--run", "smoke", "--history"]);
    let evaluation = history["evaluations"].as_array().unwrap().iter().find(|one| version(one)).unwrap();
    assert_eq!(evaluation["all"]["greedy"], summary["all"]["greedy"]["success"]);

    // Event files store 32-bit floats.
    let float = |number: &serde_json::Value| number.as_f64().unwrap() as f32;
    let path = |folder: &str| cluster.folder.path().join(folder).display().to_string();
    let plotted = output_of(python, "scalars.py", &[&path("run/tb/learner")]);
    let [step, entropy] = [0, 1].map(|i| &plotted["ppo/entropy"][0][i]);
    let update = record("learner", "run", &|line| line["n_env_steps"] == *step);
    assert_eq!(float(entropy), float(&update["ppo"]["entropy"]));
    let plotted = output_of(python, "scalars.py", &[&path("evaluated/tb/evaluator")]);
    let [step, success] = [0, 1].map(|i| &plotted["success-greedy/all"][0][i]);
    let summary = record("eval/summary", "evaluated", &|line| line["n_env_steps"] == *step);
    assert_eq!(float(success), float(&summary["all"]["greedy"]["success"]["rate"]));
}

/// Checks that trackers are told what was recorded, from `saved` steps on.
fn check_trackers(python: &OsStr, cluster: &Cluster, saved: u64) {
    let repository = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let store = cluster.folder.path().join("store");
    let track = |args: &[&str]| {
        let mut track = Command::new(python);
        track.arg(repository.join("deploy/examples/track.py")).args(args).current_dir(cluster.folder.path());
        track.env("MLFLOW_ALLOW_FILE_STORE", "true").env("MLFLOW_TRACKING_URI", format!("file://{}", store.display()));
        track.env("WANDB_MODE", "offline").env("WANDB_ERROR_REPORTING", "false");
        track.stdout(Stdio::piped());
        track
    };
    let script = repository.join("tests/processes/tracked.py");
    let tracked = |tracker, folder: &Path| output_of_script(python, &script, &[tracker, &folder.display().to_string()]);
    let updates = || {
        let recorded = metrics(&cluster.folder.path().join("run")).into_iter();
        let updates = recorded.filter(|line| line["key"] == "learner");
        updates.map(|line| serde_json::json!([line["n_env_steps"], line["ppo"]["entropy"]])).collect::<Vec<_>>()
    };

    // Track live: values as they arrive, after the latest one of each key.
    let live = [&cluster.endpoint, "--run", "smoke", "--to", "mlflow", "--config", "run/config.toml"];
    let mut listener = Process(track(&live).spawn().unwrap());
    let mut lines = lines(listener.0.stdout.take().unwrap());
    let mut missing = vec!["learner", "eval/summary"];
    // An evaluation that has ended is told at once, and there may be no other.
    assert!(lines.any(|line| {
        missing.retain(|key| *key == "learner" || !line.contains(key));
        line == "listening"
    }));
    cluster.learn(["--resume", "run"], saved + 4096);
    while !missing.is_empty() {
        let line = lines.next().expect("it listens until it is told to end");
        missing.retain(|key| !line.contains(key));
    }
    kill("-TERM", listener.0.id());
    assert!(listener.0.wait().unwrap().success());
    let kept = tracked("mlflow", &store);
    assert_eq!(kept["config"]["bus.run"], "smoke");
    assert!(!kept["metrics"]["success-greedy/all"].as_array().unwrap().is_empty());
    let recorded = updates();
    let logged = kept["metrics"]["learner/ppo/entropy"].as_array().unwrap();
    assert!(!logged.is_empty() && logged.iter().all(|update| recorded.contains(update)), "{logged:?}: {recorded:?}");

    // Track everything that a finished run left behind.
    assert!(track(&["run", "--to", "wandb"]).status().unwrap().success());
    let kept = tracked("wandb", cluster.folder.path());
    assert_eq!(kept["config"]["bus"]["run"], "smoke");
    assert_eq!(kept["metrics"]["learner/ppo/entropy"], serde_json::Value::Array(updates()));
}

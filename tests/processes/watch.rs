//! `watch` with a run on a real bus: its output, its errors when nothing arrives, and the arguments that it rejects.

use std::io::{BufRead, BufReader, Lines};
use std::path::Path;
use std::process::{ChildStdout, Command, Output, Stdio};

use crate::support::program::{check_refused, lines, lodestone, refused};
use crate::support::served::{Process, interrupt, train};
use bus::{Bus, MetricsPublisher};
use proto::Role;
use serde_json::{Value, json};

fn watch_command(folder: &Path, args: &[&str]) -> Command {
    let mut command = lodestone(folder);
    command.args(["watch", "--connect", &format!("unixsock-stream/{}", folder.join("bus.sock").display())]).args(args);
    command
}

/// Runs the program while this process keeps serving the bus.
async fn watch(folder: &Path, args: &[&str]) -> Output {
    let mut command = watch_command(folder, args);
    tokio::task::spawn_blocking(move || command.output().unwrap()).await.unwrap()
}

/// Publishes metrics under a key; they are its latest value for as long as the publisher exists.
async fn put(bus: &Bus, suffix: &str, metrics: &Value) -> MetricsPublisher {
    let publisher = bus.metrics_publisher(suffix).await.unwrap();
    publisher.put(metrics).await.unwrap();
    publisher
}

fn sample(json: &str) -> Value {
    serde_json::from_str(json).unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_run_is_printed_once() {
    let folder = tempfile::tempdir().unwrap();
    let bus = Bus::isolated(folder.path()).await.unwrap();
    let _tokens = (
        bus.declare_alive(Role::Learner, "learner").await.unwrap(),
        bus.declare_alive(Role::Actor, "actor-1").await.unwrap(),
        bus.declare_alive(Role::Actor, "quiet").await.unwrap(),
    );
    let mut hostile = sample(include_str!("../../dashboard/tests/metrics/actor.json"));
    hostile["actor"] = json!("\u{1b}[2Jred");
    let _published = [
        put(&bus, "actor/actor-1", &sample(include_str!("../../dashboard/tests/metrics/actor.json"))).await,
        put(&bus, "actor/hostile", &hostile).await,
        put(&bus, "eval/train/2_000", &sample(include_str!("../../dashboard/tests/metrics/eval-blueprint.json"))).await,
        put(&bus, "eval/train/2_001", &json!({ "schema_version": 1 })).await,
        put(&bus, "eval/summary", &sample(include_str!("../../dashboard/tests/metrics/eval-summary.json"))).await,
        put(&bus, "learner", &sample(include_str!("../../dashboard/tests/metrics/learner.json"))).await,
    ];
    let words = [
        "Run default at unixsock-stream/",
        "learner heard 0 s ago, evaluator gone, heard 0 s ago",
        "Success in %: weights 800, 3 276 800 environment steps, evaluated 0 s ago",
        "  train 2-6       100.0 ( 91.2 to 100.0)      40",
        "  worst  2_000 100.0",
        "Learning: weights 812, 3 326 976 environment steps",
        "Actors: 2 alive, 0 lost; 640 steps/s",
        // The latest values may arrive twice, when the view notices a new service.
        "watch: metrics unreadable ",
        "watch: schema unknown ",
    ];
    // A moment may pass between two messages, on a busy machine more than the command waits for.
    let has_all = |text: &str| words.iter().all(|words| text.contains(words));
    let mut stdout = String::new();
    for _ in 0..20 {
        let output = watch(folder.path(), &["--run", "default", "--once", "--timeout", "60"]).await;
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        stdout = String::from_utf8(output.stdout).unwrap();
        if has_all(&stdout) {
            break;
        }
    }
    assert!(has_all(&stdout), "not all of {words:?} in {stdout}");
    assert!(!stdout.contains('\u{1b}'), "{stdout:?}");
    let output = watch(folder.path(), &["--run", "default", "--once", "--json", "--timeout", "60"]).await;
    let known: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((known["run"].as_str(), known["is_connected"].as_bool()), (Some("default"), Some(true)));
    assert_eq!(known["learner"]["n_env_steps"], 3_326_976);
    assert_eq!(known["evaluation"]["weights_version"], 800);
    assert_eq!(known["blueprints"][0]["blueprint"], "2_000");
    assert_eq!(known["actors"][0]["actor"], "actor-1");
    assert_eq!(known["alive"]["actors"], json!(["actor-1", "quiet"]));
    bus.close().await;
}

/// Reads lines until the learner reports this many steps.
async fn wait_for_steps(mut lines: Lines<BufReader<ChildStdout>>, n_env_steps: u64) -> Lines<BufReader<ChildStdout>> {
    let read = move || loop {
        let known: Value = serde_json::from_str(&lines.next().unwrap().unwrap()).unwrap();
        if known["learner"]["n_env_steps"] == n_env_steps {
            return lines;
        }
    };
    tokio::task::spawn_blocking(read).await.unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_new_is_told_to_a_program_line_by_line() {
    let folder = tempfile::tempdir().unwrap();
    let bus = Bus::isolated(folder.path()).await.unwrap();
    let mut learner = sample(include_str!("../../dashboard/tests/metrics/learner.json"));
    let publisher = put(&bus, "learner", &learner).await;
    let mut command = watch_command(folder.path(), &["--run", "default", "--json"]);
    let mut watching = Process(command.stdout(Stdio::piped()).spawn().unwrap());
    let lines = BufReader::new(watching.0.stdout.take().unwrap()).lines();
    let lines = wait_for_steps(lines, 3_326_976).await;
    learner["n_env_steps"] = json!(3_330_000);
    publisher.put(&learner).await.unwrap();
    // The pipe is closed from here on.
    drop(wait_for_steps(lines, 3_330_000).await);
    learner["n_env_steps"] = json!(3_340_000);
    publisher.put(&learner).await.unwrap();
    let status = tokio::task::spawn_blocking(move || watching.0.wait().unwrap()).await.unwrap();
    assert!(status.success(), "{status}");
    bus.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_run_that_says_nothing_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let bus = Bus::isolated(folder.path()).await.unwrap();
    let _token = bus.declare_alive(Role::Learner, "learner").await.unwrap();
    let output = watch(folder.path(), &["--run", "elsewhere", "--once", "--timeout", "3"]).await;
    let words = "run `elsewhere` said anything in 3 s; this router has default;";
    check_refused(&output, 66, &[words], "watch");
    bus.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_missing_router_and_wrong_use_are_named() {
    let folder = tempfile::tempdir().unwrap();
    for (args, code, words) in [
        (&["--once", "--timeout", "1"][..], 65, &["no router answers at unixsock-stream/", "after 1 s"][..]),
        (&[], 2, &["needs a terminal", "--once", "--json"]),
        (&["--run", "My Run", "--once"], 2, &["--run", "My Run", "a-z"]),
        (&["--timeout", "3"], 2, &["--once"]),
        (&["--once", "--timeout", "0"], 2, &["--timeout", "1..=86400"]),
    ] {
        check_refused(&watch(folder.path(), args).await, code, words, &format!("{args:?}"));
    }
    refused(lodestone(folder.path()).arg("watch"), 2, &["--connect"]);
}

#[test]
fn a_training_is_found_by_its_folder_and_without_any_name() {
    let folder = tempfile::tempdir().unwrap();
    let runs = folder.path().join("runs");
    std::fs::create_dir(&runs).unwrap();
    let mut training = lodestone(&runs);
    train(&mut training).args(["--steps", "1000000000", "--no-web"]).stdout(Stdio::piped()).stderr(Stdio::null());
    let mut training = Process(training.spawn().unwrap());
    let mut printed = lines(training.0.stdout.take().unwrap());
    assert!(printed.any(|line| line.contains("steps/s")));
    let watch = |args: &[&str]| lodestone(folder.path()).args(["watch", "--once"]).args(args).output().unwrap();
    for args in [&[][..], &["runs/run"]] {
        let output = watch(args);
        let (shown, stderr) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        assert!(shown.contains("Run smoke at unixsock-stream/runs/run/bus.sock"), "{args:?}: {shown}{stderr}");
    }
    interrupt(&training);
    training.0.wait().unwrap();
    let output = watch(&["runs/run"]);
    check_refused(&output, 2, &["no training listens in runs/run", "serve runs/run"], "watch");
}

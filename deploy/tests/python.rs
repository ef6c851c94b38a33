//! The example client in Python reads what the evaluator says: the bus has a judge that shares no code with us.
#![allow(clippy::unwrap_used)]

mod program;

use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use program::lodestone;
use serde_json::Value;

const CLIENT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/success.py");

/// A process that does not outlive its test.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        // Both fail only for a process that has ended already, which is what is wanted.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A Python that has `eclipse-zenoh`; `.ci/run` makes one.
fn python() -> Option<std::ffi::OsString> {
    let python = std::env::var_os("LODESTONE_PYTHON");
    if python.is_none() {
        eprintln!("LODESTONE_PYTHON names no Python with eclipse-zenoh, so the client in Python was not run");
    }
    python
}

fn member(folder: &Path, role: &str, args: &[&str]) -> Process {
    let mut command = lodestone(folder);
    command.arg(role).args(args).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    Process(command.spawn().unwrap())
}

#[test]
fn the_example_client_reads_the_summary_that_the_evaluator_recorded() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    // A port that was free a moment ago; members retry until the router listens there.
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let _router = member(folder.path(), "router", &["--listen", &endpoint]);
    let task = ["--connect", &endpoint, "--preset", "near-goal"];
    let with = |more: &[&'static str]| [task.as_slice(), more].concat();
    let _learner = member(folder.path(), "learner", &with(&["--run-dir", "run"]));
    let _actor = member(folder.path(), "actor", &with(&[]));
    let _evaluator = member(folder.path(), "evaluator", &with(&["--run-dir", "judged"]));

    let read = Command::new(python).args([CLIENT, &endpoint, "--run", "near-goal", "--once"]).output().unwrap();
    assert!(read.status.success(), "{}", String::from_utf8_lossy(&read.stderr));
    let told: Value = serde_json::from_slice(&read.stdout).unwrap();
    let recorded = std::fs::read_to_string(folder.path().join("judged/metrics.jsonl")).unwrap();
    let mut summaries = recorded.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    let mut same = summaries
        .find(|line| line["key"] == "eval/summary" && line["weights_version"] == told["weights_version"])
        .unwrap();
    same.as_object_mut().unwrap().remove("key");
    assert_eq!(told, same);
    assert!(told["all"]["mode"]["success"]["n_episodes"].as_u64().unwrap() > 0);
}

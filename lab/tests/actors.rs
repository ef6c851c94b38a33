//! `lab actors` on a small scale: the counts of both ends, independent of the machine's speed.

#![allow(clippy::unwrap_used)]

use std::io::{BufRead, BufReader, Read};
use std::process::{Command, Stdio};

use serde_json::Value;

/// `lab actors`, without the caller's `LODESTONE_*` variables and `RUST_LOG`.
fn actors() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lab"));
    for (name, _) in std::env::vars().filter(|(name, _)| name.starts_with("LODESTONE_") || name == "RUST_LOG") {
        command.env_remove(name);
    }
    command.arg("actors");
    command
}

/// Runs 20 actors of the smallest preset for two seconds.
fn measure(args: &[&str]) -> Value {
    let common = ["--preset", "smoke", "--actors", "20", "--for", "2", "--json"];
    let output = actors().args(common).args(args).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn check(report: &Value) {
    let both = &report["reconciled"];
    assert!(both["agrees"] == true && both["lost"] == 0 && both["vanished"] == 0, "{both}");
    assert_eq!((&report["n_actors"], &report["n_segments"]), (&Value::from(20), &both["acked"]));
    assert!(report["n_steps"].as_u64().unwrap() > 0, "{report}");
    assert_eq!(report["counts"]["invalid_total"], 0, "{report}");
    // The counts of the ingest and its mailbox agree.
    let (ingest, mailbox) = (&report["ingest"]["ingest"], &report["ingest"]["mailbox"]);
    assert_eq!(ingest["accepted_total"], mailbox["accepted_total"]);
    for role in ["router", "ingest", "actors"] {
        assert!(report["memory"][role]["max_mb"].as_f64().unwrap() > 0.0, "{role}: {report}");
    }
}

#[test]
fn twenty_actors_at_a_rate_lose_nothing() {
    let report = measure(&["--rate", "100", "--weights-every", "0.5", "--processes", "2"]);
    check(&report);
    let deliveries = report["weights"]["deliveries"].as_array().unwrap();
    assert!(deliveries.iter().any(|delivery| delivery["n_reached"] == 20), "{deliveries:?}");
}

#[test]
fn below_two_leaves_and_at_full_speed_they_lose_nothing_either() {
    check(&measure(&["--rate", "0", "--leaves", "2", "--transport", "unix", "--weights-bytes", "100000"]));
}

#[test]
fn contradicting_arguments_are_refused() {
    let output = actors().args(["--processes", "2", "--leaves", "3"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("--processes"));
}

#[test]
fn no_process_outlives_the_one_that_measures() {
    let mut command = actors();
    command.args(["--preset", "smoke", "--actors", "2", "--for", "600"]).stderr(Stdio::piped());
    let mut measuring = command.spawn().unwrap();
    let mut log = BufReader::new(measuring.stderr.take().unwrap());
    let mut line = String::new();
    while !line.contains("all have joined") {
        line.clear();
        assert!(log.read_line(&mut line).unwrap() > 0, "it ended early");
    }
    measuring.kill().unwrap();
    measuring.wait().unwrap();
    // All processes share this pipe, so it ends with the last of them.
    log.read_to_end(&mut Vec::new()).unwrap();
}

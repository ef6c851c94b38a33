//! `bench actors` on a small scale: the counts of both ends, independent of the machine's speed.

use serde_json::Value;

use crate::support::program::lodestone;

/// Runs 20 actors of the smallest preset for two seconds.
fn measure(args: &[&str]) -> Value {
    let folder = tempfile::tempdir().unwrap();
    let common = ["bench", "actors", "--preset", "near-goal", "--actors", "20", "--for", "2", "--json"];
    let output = lodestone(folder.path()).args(common).args(args).output().unwrap();
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
    let folder = tempfile::tempdir().unwrap();
    let output =
        lodestone(folder.path()).args(["bench", "actors", "--processes", "2", "--leaves", "3"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("--processes"));
}

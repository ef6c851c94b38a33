//! The web page of a real run: its address is printed, it updates during training, and it is gone afterwards.

use std::collections::BTreeMap;
use std::env;
use std::fs::{self, Permissions};
use std::io::Read;
use std::net::{TcpListener, TcpStream};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::mpsc::channel;
use std::time::Duration;

use crate::support::judges::{output_of, python};
use crate::support::program::{LODESTONE, command, lodestone, metrics, n_saved_steps, printed, refused};
use crate::support::served::{Process, client, endless, events, get, interrupt, page, train};
use runlog::{History, RunPaths};
use serde_json::Value;

#[test]
fn a_page_shows_a_run_while_it_lasts_and_prometheus_reads_its_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let (mut run, mut printed, address) = endless(folder.path());
    // Read events until an evaluation arrives; every connection that is read to its end waits for the run.
    let mut events = events(&address);
    assert!(events.any(|line| line == "event: evaluation"));
    assert!(events.any(|line| line.contains("\"key\":\"learner\"")));
    assert!(events.any(|line| line.contains("\"key\":\"actor/")));

    assert_eq!(get(&address, "/readyz").0, 200);
    assert!(get(&address, "/").1.contains("<title>Lodestone</title>"));
    let history: Value = serde_json::from_str(&get(&address, "/api/history").1).unwrap();
    assert_eq!((&history["schema_version"], &history["blueprints"][0]["id"]), (&2.into(), &"5_001".into()));
    assert_eq!(history["evaluations"][0]["all"]["greedy"]["n_episodes"], 2);
    assert!(get(&address, "/metrics").1.contains("lodestone_alive_processes{run=\"smoke\",role=\"actor\"} 1.0\n"));
    // The one request that is refused.
    let stranger = client().get(format!("http://{address}/")).header("Host", "evil.example").call().unwrap();
    assert_eq!(stranger.status(), 403);
    let families = python().map(|python| output_of(&python, "scrape.py", &[&format!("http://{address}/metrics")]));

    interrupt(&run);
    // The event stream ends with the run and does not delay its end.
    events.for_each(drop);
    printed.read_to_string(&mut String::new()).unwrap();
    assert!(run.0.wait().unwrap().success());
    assert!(TcpStream::connect(&address).is_err());
    let run = folder.path().join("run");
    assert!(n_saved_steps(&run) > 0);
    if let Some(families) = families {
        check_scrape(&families, &run);
    }
}

/// Checks that what Prometheus read is on disk. After the run has ended, everything that it measured is.
fn check_scrape(families: &Value, run: &Path) {
    let samples = |name: &str, kind: &str| {
        let family = &families[format!("lodestone_{name}")];
        assert_eq!(family["type"], kind, "{name}");
        let of = |sample: &Value| {
            let mut labels: BTreeMap<String, String> = serde_json::from_value(sample[1].clone()).unwrap();
            assert_eq!(labels.remove("run").as_deref(), Some("smoke"));
            (labels.into_values().collect::<Vec<_>>().join(" "), sample[2].as_f64().unwrap())
        };
        family["samples"].as_array().unwrap().iter().map(of).collect::<BTreeMap<String, f64>>()
    };
    let of_all = |name| samples(name, "gauge")["greedy all"];
    let version = samples("eval_weights_version", "gauge")[""];
    let evaluations = History::read(&RunPaths::new(run).history()).unwrap();
    let evaluation = evaluations.iter().find(|evaluation| evaluation.weights_version.0 as f64 == version).unwrap();
    let success = evaluation.blueprints[0].greedy.success;
    assert_eq!(of_all("eval_group_success_ratio"), success.rate);
    assert_eq!(of_all("eval_group_success_wilson_low_ratio"), success.wilson_low);
    assert_eq!(samples("eval_group_episodes", "gauge")["greedy train 2-6"], success.n_episodes as f64);
    assert_eq!(samples("eval_blueprint_success_ratio", "gauge")["greedy 5_001 train"], success.rate);

    let n_updates = samples("learner_updates", "counter")[""];
    let is_same = |line: &Value| line["key"] == "learner" && line["n_updates"].as_f64() == Some(n_updates);
    let learner = metrics(run).into_iter().find(is_same).unwrap();
    let recorded = |value: &Value| value.as_f64().unwrap();
    assert_eq!(samples("learner_env_steps", "counter")[""], recorded(&learner["n_env_steps"]));
    assert_eq!(samples("learner_entropy_nats", "gauge")[""], recorded(&learner["ppo"]["entropy"]));
    let drops = samples("learner_trajectories_dropped", "counter");
    for reason in ["stale", "invalid", "name_taken"] {
        assert_eq!(drops[reason], recorded(&learner["ingest"][format!("{reason}_total")]), "{reason}");
    }
    assert_eq!(samples("learner_back_pressure", "counter")[""], recorded(&learner["ingest"]["full_total"]));
    assert_eq!(samples("actor_trajectories_dropped", "counter").len(), 9);
    assert_eq!(drops["unmade"], recorded(&learner["unmade_total"]));
    assert_eq!(samples("learner_bus_dropped", "counter")["weights_refused"], 0.0);
    assert_eq!(samples("page_dropped", "counter")["request_refused"], 1.0);
}

#[test]
fn play_opens_its_page_where_there_is_a_terminal_and_a_display() {
    let folder = tempfile::tempdir().unwrap();
    let [opened, browser] = ["opened", "xdg-open"].map(|name| folder.path().join(name));
    assert!(Command::new("mkfifo").arg(&opened).status().unwrap().success());
    fs::write(&browser, "#!/bin/sh\necho \"$1\" > opened\n").unwrap();
    fs::set_permissions(&browser, Permissions::from_mode(0o755)).unwrap();
    let mut script = command("script", folder.path());
    // The tests may run under `nohup`, which their children would inherit.
    let play = format!("exec env --default-signal=HUP '{LODESTONE}' play");
    script.args(["--quiet", "--command", &play, "/dev/null"]);
    script.env("PATH", format!("{}:{}", folder.path().display(), env::var("PATH").unwrap())).env("DISPLAY", ":0");
    let _playing = Process(script.stdin(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap());
    let (tell, told) = channel();
    std::thread::spawn(move || tell.send(fs::read_to_string(opened)));
    let address = told.recv_timeout(Duration::from_secs(60)).expect("the browser is started").unwrap();
    assert!(get(address.trim().strip_prefix("http://").unwrap(), "/").1.contains("<title>Lodestone</title>"));
}

#[test]
fn a_page_that_cannot_be_served_is_refused_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |address: &str, words: &str| {
        refused(train(&mut lodestone(folder.path())).args(["--web", address]), 64, &[words]);
    };
    refused("0.0.0.0:0", "dashboard.web.listen = 0.0.0.0:0, which others can reach: set dashboard.web.token");
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    refused(&address, &format!("the page cannot be served at {address}"));
    assert!(!folder.path().join("run").exists());
}

#[test]
fn runs_that_have_ended_are_shown_from_their_files() {
    let folder = tempfile::tempdir().unwrap();
    let said = printed(train(&mut lodestone(folder.path())).args(["--steps", "512", "--no-web"]));
    assert!(!said.contains("page at"), "{said}");
    let (mut serving, _printed, address) = page(lodestone(folder.path()).args(["serve", "run", "run"]));
    let json = |path: &str| -> Value { serde_json::from_str(&get(&address, path).1).unwrap() };
    let about = json("/runs/1/api/about");
    assert_eq!((&about["kind"], &about["run"]), (&"finished".into(), &"run".into()));
    assert_eq!(about["runs"].as_array().unwrap().len(), 2);
    let updates = json("/api/history")["learner"].as_array().unwrap().len();
    assert!(updates > 0);
    assert_eq!(json("/runs/1/api/history")["learner"].as_array().unwrap().len(), updates);
    // Both its newest checkpoint and the expert can build.
    for agent in ["policy", "expert"] {
        let episode = json(&format!("/api/play?blueprint=5_001&agent={agent}"));
        assert_eq!((&episode["actor"], &episode["blueprint"]), (&agent.into(), &"5_001".into()));
    }
    interrupt(&serving);
    assert!(serving.0.wait().unwrap().success());

    // A static copy of the page holds everything that a browser would request.
    let export = ["serve", "run", "--export", "copy", "--blueprint", "5_001"];
    printed(lodestone(folder.path()).args(export));
    let copied = |path: &str| std::fs::read_to_string(folder.path().join("copy").join(path)).unwrap();
    let json = |path: &str| -> Value { serde_json::from_str(&copied(path)).unwrap() };
    assert!(copied("index.html").contains("<html data-copy "));
    assert_eq!(json("api/about.json")["recorded"], serde_json::json!(["5_001"]));
    assert_eq!(json("api/history.json")["learner"].as_array().unwrap().len(), updates);
    for agent in ["policy", "expert"] {
        assert_eq!(json(&format!("api/play/5_001-{agent}.json"))["actor"], agent);
    }
    refused(lodestone(folder.path()).args(export), 1, &["cannot make the folder copy"]);
    refused(lodestone(folder.path()).args(["serve", "gone"]), 66, &["gone does not exist"]);
}

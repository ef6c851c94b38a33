//! Access control: honest members with keys can join a run, and Python clients try everything that is forbidden.

use std::fs;
use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};

use crate::support::judges::{output_of_script, python};
use crate::support::program::{finished, lodestone, quiet, refused};
use crate::support::served::Process;
use serde_json::{Value, json};

/// Time limit for every wait.
const PATIENCE: Duration = Duration::from_secs(120);

/// Resident memory of a process in bytes.
fn resident(process: &Process) -> u64 {
    let status = fs::read_to_string(format!("/proc/{}/status", process.0.id())).unwrap();
    let line = status.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<u64>().unwrap() * 1024
}

/// A router with keys, which members can join.
struct Ring {
    folder: tempfile::TempDir,
    endpoint: String,
    router: Process,
}

impl Ring {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        for keys in ["keys", "strangers"] {
            assert!(quiet(folder.path(), &["keys", "new", keys]).status().unwrap().success());
        }
        // This port was free a moment ago. Members retry until the router listens on it.
        let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let endpoint = format!("quic/127.0.0.1:{port}");
        let router = quiet(folder.path(), &["router", "--listen", &endpoint, "--keys", "keys"]).spawn().unwrap();
        Self { folder, endpoint, router: Process(router) }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn member(&self, role: &str, args: &[&str]) -> Process {
        let shared = [role, "--connect", &self.endpoint, "--preset", "smoke", "--health-file", role];
        Process(quiet(self.folder.path(), &shared).args(args).spawn().unwrap())
    }

    /// The newest line that the learner has written about its updates, if any.
    fn newest_update(&self) -> Option<Value> {
        let lines = fs::read_to_string(self.path("run/metrics.jsonl")).ok()?;
        lines.lines().rev().find_map(|line| serde_json::from_str(line).ok())
    }

    /// Waits for an update for which `holds` returns true.
    fn update_after_which(&self, holds: impl Fn(&Value) -> bool) -> Value {
        until("an update", || {
            // Returns once the run has published something, so this loop does not spin.
            self.watch();
            self.newest_update().filter(&holds)
        })
    }

    /// The output of `watch` with the viewer's keys.
    fn watch(&self) -> String {
        let mut command =
            quiet(self.folder.path(), &["watch", "--once", "--connect", &self.endpoint, "--keys", "keys"]);
        let watched = command.args(["--run", "smoke"]).stdout(Stdio::piped()).output().unwrap();
        String::from_utf8(watched.stdout).unwrap()
    }
}

/// Calls `ask` until it returns a value.
fn until<T>(what: &str, mut ask: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(answer) = ask() {
            return answer;
        }
        assert!(start.elapsed() < PATIENCE, "{what} did not come in {PATIENCE:?}");
    }
}

fn count(update: &Value, pointer: &str) -> u64 {
    update.pointer(pointer).and_then(Value::as_u64).unwrap()
}

#[test]
fn members_with_keys_train_and_everybody_else_is_kept_out() {
    let Some(python) = python() else { return };
    let ring = Ring::start();
    let learner = ring.member("learner", &["--keys", "keys", "--run-dir", "run"]);
    // The folder of its own role is all that an actor needs.
    let _actor = ring.member("actor", &["--keys", "keys/actor", "--id", "honest"]);
    let soon = ["--set", "evaluator.every={versions=1}", "--set", "evaluator.episodes.n_episodes=1"];
    let _evaluator = ring.member("evaluator", &[&["--keys", "keys"][..], &soon].concat());
    ring.update_after_which(|update| count(update, "/ingest/accepted_total") > 0);
    for role in ["learner", "actor", "evaluator"] {
        let mut check = quiet(ring.folder.path(), &["healthcheck", "--file", role]);
        until(role, || check.status().unwrap().success().then_some(()));
    }
    until("everybody on the screen", || {
        let text = ring.watch();
        (text.contains("honest") && text.contains("evaluator heard")).then_some(())
    });

    let memory = [resident(&ring.router), resident(&learner)];
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/processes/rogue.py");
    let [keys, strangers] = ["keys", "strangers"].map(|name| ring.path(name).display().to_string());
    let report = output_of_script(&python, &script, &[&ring.endpoint, &keys, &strangers, "smoke"]);

    for who in ["without_keys", "without_encryption", "stranger", "mixed"] {
        assert_eq!(report[who], false, "{who}");
    }
    assert_eq!(report["honest"], true);
    // For each role, the keys that it can read, query, and put. No process accepts its replies.
    for (role, read, asked, put) in [
        ("viewer", json!(["metrics/**", "**"]), json!(["metrics/learner", "history/eval"]), json!([])),
        (
            "actor",
            json!([]),
            json!(["weights/latest", "ingest/rogue"]),
            json!(["metrics/actor/rogue", "trajectories/rogue"]),
        ),
        (
            "evaluator",
            json!(["trajectories/*", "metrics/**", "**"]),
            json!(["weights/latest", "metrics/learner"]),
            json!(["metrics/eval/summary"]),
        ),
    ] {
        let attack = &report["attacks"][role];
        // A client reads only what is published meanwhile, and its puts reach only subscribers that the router already
        // knows.
        for (found, allowed) in [(&attack["read"], &read), (&attack["put"], &put)] {
            let allowed = allowed.as_array().unwrap();
            assert!(found.as_array().unwrap().iter().all(|key| allowed.contains(key)), "{role}: {found}");
        }
        assert_eq!([&attack["asked"], &attack["believed"]], [&asked, &json!([])], "{role}");
    }
    // Every message of the flood was counted by the learner and discarded, and some were told why.
    assert!((1..=report["n_flood"].as_u64().unwrap()).contains(&report["flood_answered"].as_u64().unwrap()));
    let n_flood = report["n_flood"].as_u64().unwrap();
    let update = ring.update_after_which(|update| count(update, "/ingest/invalid_total") >= n_flood);
    let verdicts = update["ingest"].as_object().unwrap().iter().filter(|(name, _)| *name != "received_total");
    let n_verdicts: u64 = verdicts.map(|(_, n)| n.as_u64().unwrap()).sum();
    // Messages waiting in the queue have no verdict yet.
    let n_received = count(&update, "/ingest/received_total");
    assert!((n_verdicts..=n_verdicts + 256).contains(&n_received), "{n_received} received, {n_verdicts} verdicts");
    for (before, process) in memory.into_iter().zip([&ring.router, &learner]) {
        let grown = resident(process).saturating_sub(before);
        assert!(grown < 300 << 20, "{grown} bytes");
    }
    // The training went on during the attacks, and still does.
    let n_steps = count(&update, "/n_env_steps");
    ring.update_after_which(|update| count(update, "/n_env_steps") > n_steps);
}

#[test]
fn nobody_listens_to_the_world_without_keys() {
    let folder = tempfile::tempdir().unwrap();
    for (args, words) in [
        (&["router", "--listen", "tcp/0.0.0.0:7447"][..], &["tcp/0.0.0.0:7447", "lodestone keys new"][..]),
        (&["router", "--listen", "quic/0.0.0.0:7447"], &["quic/0.0.0.0:7447", "lodestone keys new"]),
        (&["router", "--listen", "tcp/[::]:7447"], &["tcp/[::]:7447", "lodestone keys new"]),
        (&["train", "--listen", "tcp/0.0.0.0:7447"], &["tcp/0.0.0.0:7447", "lodestone keys new"]),
        (&["actor", "--connect", "quic/127.0.0.1:1"], &["quic/127.0.0.1:1", "--keys"]),
        (&["actor", "--connect", "quic/127.0.0.1:1", "--keys", "absent"], &["absent/ca.pem", "lodestone keys new"]),
    ] {
        refused(lodestone(folder.path()).args(args), 64, words);
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn keys_are_private_whole_and_never_overwritten() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let keys = |args: &[&str]| finished(lodestone(folder.path()).arg("keys").args(args));
    keys(&["new", "keys", "--host", "router,10.0.0.7"]);
    let mode = |path: PathBuf| fs::metadata(path).unwrap().permissions().mode() & 0o777;
    for role in ["ca", "router", "learner", "actor", "evaluator", "viewer"] {
        let of_role = folder.path().join("keys").join(role);
        assert_eq!(mode(of_role.clone()), 0o700, "{role}");
        for file in fs::read_dir(&of_role).unwrap() {
            assert_eq!(mode(file.unwrap().path()), 0o600, "{role}");
        }
    }
    let key = || fs::read(folder.path().join("keys/router/key.pem")).unwrap();
    let before = key();
    refused(lodestone(folder.path()).args(["keys", "new", "keys"]), 2, &[]);
    keys(&["new", "keys", "--keep"]);
    assert_eq!(key(), before);
    let authority = fs::read(folder.path().join("keys/actor/ca.pem")).unwrap();
    keys(&["router", "keys", "--host", "elsewhere"]);
    assert_ne!(key(), before);
    assert_eq!(fs::read(folder.path().join("keys/router/ca.pem")).unwrap(), authority);
    let wrong = ["keys", "new", "others", "--host", "not a name"];
    refused(lodestone(folder.path()).args(wrong), 64, &["`not a name`"]);
    assert!(!folder.path().join("others").exists());
}

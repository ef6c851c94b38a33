//! Long commands end with a signal, and when their terminal is closed, whatever they wait for.

use std::fs::File;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use bus::Bus;
use proto::Role;
use serde_json::Value;

use crate::support::program::{LODESTONE, command, finished, kill, lines, lodestone, n_saved_steps, refused};
use crate::support::served::{Process, train};

/// How long a process may take to end on a busy machine. Nothing else ends those that wait for a router.
const PATIENCE: Duration = Duration::from_secs(60);

/// A router that takes connections and never answers.
struct Silent(TcpListener);

impl Silent {
    fn new() -> Self {
        Self(TcpListener::bind("127.0.0.1:0").unwrap())
    }

    fn endpoint(&self) -> String {
        format!("tcp/{}", self.0.local_addr().unwrap())
    }

    /// Waits until a process that is started now says that it has waited for the router for a while.
    fn outlast(&self, folder: &Path) {
        let mut late = lodestone(folder);
        late.args(["actor", "--connect", &self.endpoint()]).stdout(Stdio::null()).stderr(Stdio::piped());
        let mut late = Process(late.spawn().unwrap());
        assert!(lines(late.0.stderr.take().unwrap()).any(|line| line.contains("no router answers")));
    }
}

#[test]
fn whoever_waits_for_a_router_ends_with_a_signal() {
    let folder = tempfile::tempdir().unwrap();
    let silent = Silent::new();
    let endpoint = silent.endpoint();
    let commands: [&[&str]; 5] =
        [&["actor"], &["learner", "--run-dir", "run"], &["evaluator"], &["watch", "--json"], &["watch", "--once"]];
    let mut waiting: Vec<Process> = Vec::new();
    let mut connections = Vec::new();
    for command in commands {
        let mut process = lodestone(folder.path());
        process.args(command).args(["--connect", &endpoint]).stdout(Stdio::null()).stderr(Stdio::null());
        waiting.push(Process(process.spawn().unwrap()));
        connections.push(silent.0.accept().unwrap());
    }
    waiting.iter().for_each(|process| kill("-TERM", process.0.id()));
    // A process that ignored the signal would wait for ever.
    for (process, command) in waiting.iter_mut().zip(commands) {
        let status = process.0.wait().unwrap();
        assert!(status.success(), "{command:?}: {status:?}");
    }
}

#[test]
fn a_command_whose_patience_is_over_ends_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let silent = Silent::new();
    let endpoint = silent.endpoint();
    let mut watch = lodestone(folder.path());
    watch.args(["watch", "--once", "--timeout", "1", "--connect", &endpoint]);
    let mut watch = Process(watch.stderr(Stdio::null()).spawn().unwrap());
    let _connection = silent.0.accept().unwrap();
    silent.outlast(folder.path());
    assert_eq!(watch.0.try_wait().unwrap().and_then(|status| status.code()), Some(65));
}

/// Starts the program in a terminal of its own, waits until it prints `words` there, and closes the terminal. Returns
/// what tells when the process has ended.
fn closed(folder: &Path, name: &str, args: &[&str], words: &str) -> Receiver<()> {
    let alive = folder.join(format!("{name}.alive"));
    assert!(Command::new("mkfifo").arg(&alive).status().unwrap().success());
    let (ended, end) = channel();
    let fifo = alive.clone();
    // Whatever writes to the pipe is the process alone: reading ends when it does.
    std::thread::spawn(move || {
        File::open(fifo).unwrap().read_to_end(&mut Vec::new()).unwrap();
        ended.send(())
    });
    // The tests may run under `nohup`, which their children would inherit.
    let mut line = "stty rows 30 cols 100; exec env --default-signal=HUP".to_owned();
    for word in [LODESTONE].iter().chain(args) {
        line += &format!(" '{word}'");
    }
    line += &format!(" 3>'{}'", alive.display());
    let mut script = command("script", folder);
    script.args(["--quiet", "--flush", "--command", &line, "/dev/null"]);
    script.env("TERM", "xterm").stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut script = Process(script.spawn().unwrap());
    let mut printed = String::new();
    let mut is_asked = false;
    let mut screen = script.0.stdout.take().unwrap();
    let mut bytes = [0; 4096];
    while !printed.contains(words) {
        let n_bytes = screen.read(&mut bytes).unwrap();
        assert!(n_bytes > 0, "{args:?} ended: {printed}");
        printed.push_str(&String::from_utf8_lossy(&bytes[..n_bytes]));
        if !is_asked && printed.contains("\u{1b}[6n") {
            is_asked = true;
            // Where the cursor is.
            script.0.stdin.as_mut().unwrap().write_all(b"\x1b[1;1R").unwrap();
        }
    }
    end
}

#[test]
fn a_closed_terminal_ends_every_long_command() {
    let folder = tempfile::tempdir().unwrap();
    let silent = Silent::new();
    let connect = ["--connect", &silent.endpoint()];
    finished(train(&mut lodestone(folder.path())).args(["--steps", "256", "--no-web"]));
    let listen = format!("unixsock-stream/{}", folder.path().join("bus.sock").display());
    let long: [(&[&str], &str); 10] = [
        (&["watch", connect[0], connect[1]], "No router"),
        (&["actor", connect[0], connect[1]], "router:"),
        (&["learner", connect[0], connect[1], "--run-dir", "other"], "everything goes to"),
        (&["evaluator", connect[0], connect[1]], "router:"),
        (&["router", "--listen", &listen], "routing"),
        (&["serve", "run"], "Ctrl-C ends"),
        (&["play"], "Ctrl-C ends"),
        (&["eval", "--pretrained"], "episodes"),
        (&["eval", "--expert"], "episodes"),
        (&["record", "--pretrained", "--split", "train", "--out", "recorded"], "episodes"),
    ];
    let mut ends = Vec::new();
    for (number, (args, words)) in long.iter().enumerate() {
        ends.push(closed(folder.path(), &number.to_string(), args, words));
    }
    let before = n_saved_steps(&folder.path().join("run"));
    ends.push(closed(folder.path(), "train", &["train", "--resume", "run", "--steps", "1000000000"], "steps/s"));
    let names = long.iter().map(|(args, _)| args[0]).chain(["train"]);
    let running: Vec<&str> =
        names.zip(&ends).filter(|(_, end)| end.recv_timeout(PATIENCE).is_err()).map(|(name, _)| name).collect();
    assert!(running.is_empty(), "{running:?} go on");
    assert!(!folder.path().join("runs").exists(), "`play` writes nothing");
    let after = n_saved_steps(&folder.path().join("run"));
    assert!(after > before, "it saved {after} steps after {before}");
}

/// A learner or an actor whose name another process has prints nothing of that process.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nobody_prints_the_progress_of_another_process() {
    let folder = tempfile::tempdir().unwrap();
    let bus = Bus::isolated(folder.path()).await.unwrap();
    let socket = format!("unixsock-stream/{}", folder.path().join("bus.sock").display());
    let metrics = [
        ("learner", "learner", include_str!("../../dashboard/tests/metrics/learner.json")),
        ("actor", "actor/twin", include_str!("../../dashboard/tests/metrics/actor.json")),
    ];
    for (role, key, json) in metrics {
        let name = if role == "learner" { (Role::Learner, "learner") } else { (Role::Actor, "twin") };
        let _first = bus.declare_alive(name.0, name.1).await.unwrap();
        let publisher = bus.metrics_publisher(key).await.unwrap();
        publisher.put(&serde_json::from_str::<Value>(json).unwrap()).await.unwrap();
        let mut second = lodestone(folder.path());
        second.args([role, "--connect", &socket, "--run", "default"]);
        second.args(if role == "learner" { ["--run-dir", "run"] } else { ["--id", "twin"] });
        let mut second = Process(second.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap());
        let printed = tokio::task::spawn_blocking(move || {
            let mut said = lines(second.0.stderr.take().unwrap());
            assert!(said.any(|line| line.contains("the name is in use")));
            kill("-TERM", second.0.id());
            let mut printed = String::new();
            second.0.stdout.take().unwrap().read_to_string(&mut printed).unwrap();
            printed
        });
        let printed = printed.await.unwrap();
        assert!(!printed.contains("steps/s"), "{role}: {printed}");
    }
    bus.close().await;
}

#[test]
fn a_limit_of_few_open_files_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let socket = format!("unixsock-stream/{}", folder.path().join("bus.sock").display());
    for args in [&["train", "--run-dir", "run"][..], &["router", "--listen", &socket], &["eval", "--pretrained"]] {
        let mut limited = command("sh", folder.path());
        limited.args(["-c", "ulimit -n 16; exec \"$@\"", "sh", LODESTONE]).args(args);
        refused(&mut limited, 71, &["may have 16 files open at once", "ulimit -n 1024"]);
    }
    assert!(!folder.path().join("run").exists());
}

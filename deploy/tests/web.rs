//! The page of a real run: found by the line that is printed, filled while training goes on, gone afterwards.
#![allow(clippy::unwrap_used)]

mod program;

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::{Child, Command, Output, Stdio};

use program::{lodestone, n_saved_steps};

/// A process that does not outlive its test.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        // Both fail only for a process that has ended already, which is what is wanted.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The smallest run that is judged.
fn train(command: &mut Command) -> &mut Command {
    command.args(["train", "--preset", "near-goal", "--run-dir", "run"]);
    for setting in [
        "learner.steps_per_update=256",
        "actor.n_worlds=8",
        "evaluator.episodes.n_episodes=2",
        "policy.network.width=16",
        "policy.network.value_hidden=[16]",
    ] {
        command.args(["--set", setting]);
    }
    command
}

fn get(address: &str, path: &str) -> (String, String) {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.write_all(format!("GET {path} HTTP/1.1\r\nHost: {address}\r\n\r\n").as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    (head.to_owned(), body.to_owned())
}

fn error(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn a_page_shows_a_run_while_it_lasts() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = lodestone(folder.path());
    let run = train(&mut command).args(["--steps", "1000000000", "--web", "127.0.0.1:0"]);
    let mut run = Process(run.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap());
    let mut lines = BufReader::new(run.0.stdout.take().unwrap()).lines().map(Result::unwrap);
    let address = lines.find_map(|line| Some(line.strip_prefix("page at http://")?.to_owned())).unwrap();
    // Events come until something was judged; each connection that is read to its end waits for the run.
    let mut stream = TcpStream::connect(&address).unwrap();
    stream.write_all(format!("GET /api/events HTTP/1.1\r\nHost: {address}\r\n\r\n").as_bytes()).unwrap();
    let mut events = BufReader::new(stream).lines().map_while(Result::ok);
    assert!(events.any(|line| line == "event: pass"));
    assert!(events.any(|line| line.contains("\"key\":\"learner\"")));

    assert!(get(&address, "/readyz").0.starts_with("HTTP/1.1 200"));
    assert!(get(&address, "/").1.contains("<title>Lodestone</title>"));
    let history: serde_json::Value = serde_json::from_str(&get(&address, "/api/history").1).unwrap();
    assert_eq!((&history["schema_version"], &history["blueprints"][0]["id"]), (&1.into(), &"2_000".into()));
    assert_eq!(history["passes"][0]["all"]["mode"]["n_episodes"], 2);
    assert!(get(&address, "/metrics").1.contains("lodestone_alive_processes{role=\"actor\"} 1.0\n"));

    let interrupted = Command::new("kill").args(["-INT", &run.0.id().to_string()]).status().unwrap();
    assert!(interrupted.success());
    // The stream of events ends with the run, and does not hold it up.
    events.for_each(drop);
    assert!(run.0.wait().unwrap().success());
    assert!(TcpStream::connect(&address).is_err());
    assert!(n_saved_steps(&folder.path().join("run")) > 0);
}

#[test]
fn a_page_that_cannot_be_served_is_refused_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let train = |address: &str| train(&mut lodestone(folder.path())).args(["--web", address]).output().unwrap();
    let open = train("0.0.0.0:0");
    assert_eq!(open.status.code(), Some(64));
    assert!(
        error(&open).contains("evaluator.web.listen is 0.0.0.0:0, which others can reach: set web.token"),
        "{}",
        error(&open)
    );
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let refused = train(&address);
    assert_eq!(refused.status.code(), Some(64));
    assert!(error(&refused).contains(&format!("the page cannot be served at {address}")), "{}", error(&refused));
    assert!(!folder.path().join("run").exists());
}

//! A small run with a web page.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};

use ureq::Agent;

use super::program::{SMALL, kill, lodestone};

/// A process that is killed when dropped.
pub(crate) struct Process(pub(crate) Child);

impl Drop for Process {
    fn drop(&mut self) {
        // Both calls fail only if the process has already exited, which is fine.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Sends the process what Ctrl-C sends.
pub(crate) fn interrupt(process: &Process) {
    kill("-INT", process.0.id());
}

/// Adds the arguments of the smallest training with evaluations.
pub(crate) fn train(command: &mut Command) -> &mut Command {
    command.args(["train", "--preset", "smoke", "--run-dir", "run"]).args(SMALL);
    command.args(["--set", "evaluator.episodes.acting=[\"greedy\"]"])
}

/// Starts the program and reads what it prints up to the address of its page; returns both with the rest.
pub(crate) fn page(command: &mut Command) -> (Process, BufReader<ChildStdout>, String) {
    let mut process = Process(command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap());
    let mut printed = BufReader::new(process.0.stdout.take().unwrap());
    let mut lines = printed.by_ref().lines().map(Result::unwrap);
    let address = lines.find_map(|line| Some(line.strip_prefix("page at http://")?.to_owned())).unwrap();
    (process, printed, address)
}

/// Starts a run without a step limit in `folder`, as [`page`] does.
pub(crate) fn endless(folder: &Path) -> (Process, BufReader<ChildStdout>, String) {
    page(train(&mut lodestone(folder)).args(["--steps", "1000000000", "--web", "127.0.0.1:0"]))
}

/// A client that uses no proxy and returns responses of any status as `Ok`.
pub(crate) fn client() -> Agent {
    Agent::config_builder().proxy(None).http_status_as_error(false).build().new_agent()
}

/// Lines of the page's event stream, until the page closes it.
pub(crate) fn events(address: &str) -> impl Iterator<Item = String> {
    let answer = client().get(format!("http://{address}/api/events")).call().unwrap();
    BufReader::new(answer.into_body().into_reader()).lines().map_while(Result::ok)
}

/// The status and body of a response.
pub(crate) fn get(address: &str, path: &str) -> (u16, String) {
    let mut answer = client().get(format!("http://{address}{path}")).call().unwrap();
    (answer.status().as_u16(), answer.body_mut().read_to_string().unwrap())
}

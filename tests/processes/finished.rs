//! The web page for finished runs: several side by side, and a static copy that any web server can serve.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::Value;

use crate::support::program::lodestone;
use crate::support::served::{Process, get, train};
use crate::support::webdriver::Browser;

/// Creates two short runs in the folder, `first` and `second`. A run this short may end before any evaluation except
/// that of its last weights, so that one is enabled.
fn train_two(folder: &Path) {
    for (name, seed) in [("first", "1"), ("second", "2")] {
        let mut command = lodestone(folder);
        let run = train(&mut command).args(["--set", "evaluator.evaluate_last=true"]);
        let run = run.args(["--steps", "512", "--seed", seed, "--no-web"]);
        let trained = run.output().unwrap();
        assert!(trained.status.success(), "{}", String::from_utf8_lossy(&trained.stderr));
        std::fs::rename(folder.join("run"), folder.join(name)).unwrap();
    }
}

/// Whether every chart has a curve of both runs.
const ARE_SIDE_BY_SIDE: &str = "document.querySelector('#curves canvas') && document.querySelector('#health canvas')
    && [...document.querySelectorAll('.charts .reading')].every((one) => /first .*second /.test(one.textContent))";

/// Starts a server of pages and finds its address in its output.
fn serve(command: &mut Command, before: &str, after: &str) -> (Process, String) {
    let mut server = Process(command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap());
    let mut lines = BufReader::new(server.0.stdout.take().unwrap()).lines().map(Result::unwrap);
    let address = lines.find_map(|line| {
        let (_, rest) = line.split_once(before)?;
        Some(rest.split_once(after).map_or(rest, |(address, _)| address).to_owned())
    });
    (server, address.unwrap())
}

fn complaints(browser: &Browser) -> Vec<Value> {
    browser.log("browser").into_iter().filter(|entry| entry["level"] == "SEVERE").collect()
}

#[test]
fn finished_runs_stand_side_by_side_and_their_policies_play() {
    let Some(driver) = std::env::var_os("LODESTONE_CHROMEDRIVER") else { return };
    let folder = tempfile::tempdir().unwrap();
    train_two(folder.path());
    let (_server, address) = serve(lodestone(folder.path()).args(["serve", "first", "second"]), "page at ", "\n");
    let browser = Browser::start(&driver, folder.path());
    browser.open(&address);
    browser.until("document.querySelector('#state').textContent === 'finished'");
    let options =
        browser.run("return [...document.querySelectorAll('#run-name option')].map((one) => one.textContent)");
    assert_eq!(options, serde_json::json!(["first", "second"]));
    browser.until(ARE_SIDE_BY_SIDE);
    assert_eq!(browser.run(include_str!("curves.js")), serde_json::json!([]));
    // The heat map opens a recorded episode. Of evaluations in quick succession, only the first is recorded.
    let videos: Value = serde_json::from_str(&get(address.strip_prefix("http://").unwrap(), "/api/videos").1).unwrap();
    let recorded = &videos["videos"][0]["weights_version"];
    assert!(recorded.is_u64(), "{videos}");
    browser
        .until(&format!("heat.rows.length === 1 && heat.passes.some((pass) => pass.weights_version === {recorded})"));
    let column = format!("heat.passes.findIndex((pass) => pass.weights_version === {recorded})");
    browser.run(&format!("heat.move({{ row: 0, column: {column} }}); heat.open()"));
    browser.until("!document.querySelector('#replay-player').hidden");
    assert!(browser.text("#replay-note").contains(" in an evaluation of weights "), "{}", browser.text("#replay-note"));
    // Other episodes are run on demand, by the policy of the selected run.
    browser.open(&format!("{address}/?run=1&axis=elapsed_s&smoothing=0.6"));
    browser.until("document.querySelector('#run-name select')?.value === '1'");
    browser.until("health.options.smoothing === 0.6 && document.querySelector('#chart-axis').value === 'elapsed_s'");
    browser.element("#stage-next").click();
    browser.until("replay.episode && !document.querySelector('#replay-player').hidden");
    assert!(browser.text("#replay-note").starts_with("The policy builds "), "{}", browser.text("#replay-note"));
    assert_eq!(complaints(&browser), Vec::<Value>::new());
}

#[test]
fn a_copy_of_the_page_works_from_any_web_server() {
    let Some(driver) = std::env::var_os("LODESTONE_CHROMEDRIVER") else { return };
    let folder = tempfile::tempdir().unwrap();
    train_two(folder.path());
    let exported = lodestone(folder.path()).args(["serve", "first", "second", "--export", "copy"]).output().unwrap();
    assert!(exported.status.success(), "{}", String::from_utf8_lossy(&exported.stderr));
    // A plain file server that knows nothing about this program.
    let mut python = Command::new("python3");
    let files = python.args(["-u", "-m", "http.server", "--bind", "127.0.0.1", "0"]).current_dir(folder.path());
    let (_server, address) = serve(files, "(", "/)");
    let browser = Browser::start(&driver, folder.path());
    browser.open(&format!("{address}/copy/"));
    browser.until("document.querySelector('#state').textContent === 'a copy'");
    // The copy starts with an episode and shows the numbers, but has no controls that would need the program.
    browser.until("replay.episode && !document.querySelector('#replay-player').hidden");
    assert_eq!(browser.run("return replay.episode.blueprint"), "2_000");
    browser.until("document.querySelector('#groups caption')?.textContent.includes('weights')");
    assert_eq!(browser.run("return document.querySelector('#draw, #stage-again, #replay-ask, footer')"), Value::Null);
    browser.element("#stage-agent input[value=expert]").click();
    browser.until("document.querySelector('#replay-note').textContent.startsWith('The expert builds ')");
    browser.until(ARE_SIDE_BY_SIDE);
    let seen = complaints(&browser);
    // Browsers request this icon from every server.
    let others: Vec<&Value> = seen.iter().filter(|entry| !entry["message"].to_string().contains("favicon")).collect();
    assert_eq!(others, Vec::<&Value>::new());
}

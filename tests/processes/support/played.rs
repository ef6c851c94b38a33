//! The page of `play` in a browser.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::Stdio;

use serde_json::Value;

use super::program::lodestone;
use super::served::Process;
use super::webdriver::Browser;

/// Starts `play` with these goals in `folder`, and opens its page in a browser; `None` if there is no driver.
pub(crate) fn played(folder: &Path, goals: &[&str]) -> Option<(Browser, Process)> {
    let driver = std::env::var_os("LODESTONE_CHROMEDRIVER")?;
    let mut command = lodestone(folder);
    let playing = command.arg("play").args(goals).args(["--episodes", "1", "--run-dir", "played"]);
    let mut playing = Process(playing.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap());
    let mut lines = BufReader::new(playing.0.stdout.take().unwrap()).lines().map(Result::unwrap);
    let address = lines.find_map(|line| Some(line.strip_prefix("page at ")?.to_owned())).unwrap();
    let browser = Browser::start(&driver, folder);
    browser.open(&address);
    Some((browser, playing))
}

/// Errors in the page's console.
pub(crate) fn errors(browser: &Browser) -> Vec<Value> {
    browser.log("browser").into_iter().filter(|entry| entry["level"] == "SEVERE").collect()
}

//! The page of `play` in a browser.

use std::path::Path;

use serde_json::Value;

use super::program::lodestone;
use super::served::{Process, page};
use super::webdriver::Browser;

/// Starts `play` with these goals in `folder`, and opens its page in a browser; `None` if there is no driver.
pub(crate) fn played(folder: &Path, goals: &[&str]) -> Option<(Browser, Process)> {
    let driver = std::env::var_os("LODESTONE_CHROMEDRIVER")?;
    let mut command = lodestone(folder);
    let (playing, _, address) = page(command.arg("play").args(goals));
    let browser = Browser::start(&driver, folder, &format!("http://{address}"));
    Some((browser, playing))
}

/// Errors in the page's console.
pub(crate) fn errors(browser: &Browser) -> Vec<Value> {
    browser.log("browser").into_iter().filter(|entry| entry["level"] == "SEVERE").collect()
}

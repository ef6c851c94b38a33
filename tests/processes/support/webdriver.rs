//! A browser driven by the W3C WebDriver protocol: JSON over HTTP, of which the tests need a dozen calls.

use std::io::BufReader;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use serde_json::{Value, json};
use ureq::http::Response;
use ureq::{Agent, Body};

use super::program::lines;
use super::served::client;

/// Time limit for a condition on a page, in milliseconds.
const PATIENCE_MS: u64 = 120_000;

/// How often to try to start chromedriver. It takes a free port of one address family and then the same port of the
/// other; if another process holds that one, it exits.
const DRIVER_STARTS: usize = 10;

// Keys, as private-use code points of the protocol.
pub(crate) const TAB: &str = "\u{e004}";
pub(crate) const ENTER: &str = "\u{e007}";
pub(crate) const HOME: &str = "\u{e011}";
pub(crate) const RIGHT: &str = "\u{e014}";

/// The key under which the protocol returns element ids.
const ELEMENT: &str = "element-6066-11e4-a52e-4f735466cecf";

/// The parts of the page that tests look into.
const PAGE: &str = "
    const from = (name) => import(new URL(name, document.baseURI).href);
    const { curves, editor, health, heat, replay, snapshots } = await from('app.js');
    const { model } = await from('model.js');
    const { apart3, placed } = await from('solid.js');
";

/// A headless Chromium with one window; it is closed when dropped.
pub(crate) struct Browser {
    driver: Child,
    client: Agent,
    /// URL of the session, without a trailing slash.
    session: String,
}

/// An element of the page.
pub(crate) struct Element<'b> {
    browser: &'b Browser,
    id: String,
}

/// Starts a driver; returns it and the port that it listens on, or `None` if it exits before it listens.
fn start_driver(chromedriver: &std::ffi::OsStr) -> Option<(Child, u16)> {
    let mut driver = Command::new(chromedriver).arg("--port=0").stdout(Stdio::piped()).spawn().unwrap();
    let port_of = |line: String| line.strip_suffix('.')?.rsplit_once("on port ")?.1.parse().ok();
    let port = lines(driver.stdout.take().unwrap()).find_map(port_of);
    if port.is_none() {
        driver.wait().unwrap();
    }
    Some((driver, port?))
}

impl Browser {
    /// Starts `chromedriver` and a browser with a new profile in `folder`, and opens `url`.
    pub(crate) fn start(chromedriver: &std::ffi::OsStr, folder: &Path, url: &str) -> Self {
        let (driver, port) = (0..DRIVER_STARTS)
            .find_map(|_| start_driver(chromedriver))
            .expect("chromedriver ended at each start without naming its port");
        let mut browser = Self { driver, client: client(), session: format!("http://127.0.0.1:{port}/session") };
        let profile = format!("--user-data-dir={}", folder.join("profile").display());
        // Without a sandbox, because containers run as root and the page is trusted.
        let mut args = vec!["--headless", "--no-sandbox", "--disable-quic", "--no-first-run"];
        // 3D graphics are rendered in software, which gives the same result everywhere.
        args.extend(["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]);
        // A quarter of the pixels, because each takes its time in software. The layout is the same.
        args.push("--force-device-scale-factor=0.5");
        args.extend(["--disable-background-networking", "--disable-component-update", "--disable-sync", &profile]);
        let wanted = json!({ "capabilities": { "alwaysMatch": {
            "goog:chromeOptions": { "args": args },
            "goog:loggingPrefs": { "browser": "ALL", "performance": "ALL" },
            "timeouts": { "script": PATIENCE_MS },
        } } });
        let session = browser.post("", &wanted);
        browser.session += &format!("/{}", session["sessionId"].as_str().unwrap());
        browser.open(url);
        browser
    }

    pub(crate) fn open(&self, url: &str) {
        self.post("/url", &json!({ "url": url }));
    }

    /// Runs a function with this body on the page, where it sees [`PAGE`], and returns its result.
    pub(crate) fn run(&self, body: &str) -> Value {
        self.tell(body).unwrap_or_else(|error| panic!("{body}: {error}"))
    }

    /// Returns the browser's message if the function fails.
    fn tell(&self, body: &str) -> Result<Value, String> {
        let script = format!(
            "const done = arguments[arguments.length - 1];
             (async () => {{ {PAGE} {body} }})().then((value) => done([value]), (error) => done(`${{error}}`));"
        );
        let answer = self.ask("/execute/async", &json!({ "script": script, "args": [] }))?;
        answer.as_str().map_or_else(|| Ok(answer[0].clone()), |error| Err(error.to_owned()))
    }

    /// Waits until `expression` is truthy on the page; returns its value.
    pub(crate) fn until(&self, expression: &str) -> Value {
        let body = format!(
            "for (;;) {{
                 const found = ({expression});
                 if (found) return found;
                 await new Promise((again) => setTimeout(again, 20));
             }}"
        );
        self.tell(&body).unwrap_or_else(|error| {
            let page = self.run("return document.body.innerText");
            panic!("{expression}: {error}\n{}\n{:?}", page.as_str().unwrap_or_default(), self.log("browser"))
        })
    }

    /// The text of the first element that matches `selector`.
    pub(crate) fn text(&self, selector: &str) -> String {
        self.run(&format!("return document.querySelector({selector:?}).textContent")).as_str().unwrap().to_owned()
    }

    pub(crate) fn elements(&self, selector: &str) -> Vec<Element<'_>> {
        let found = self.post("/elements", &json!({ "using": "css selector", "value": selector }));
        let id = |element: &Value| element[ELEMENT].as_str().unwrap().to_owned();
        found.as_array().unwrap().iter().map(|element| Element { browser: self, id: id(element) }).collect()
    }

    /// The only element that matches `selector`.
    pub(crate) fn element(&self, selector: &str) -> Element<'_> {
        let mut all = self.elements(selector);
        assert_eq!(all.len(), 1, "{selector}");
        all.remove(0)
    }

    /// Presses keys, one after the other, wherever the focus is.
    pub(crate) fn keys(&self, keys: &str) {
        let action = |kind: &str, key: char| json!({ "type": kind, "value": key.to_string() });
        let all: Vec<Value> = keys.chars().flat_map(|key| [action("keyDown", key), action("keyUp", key)]).collect();
        self.post("/actions", &json!({ "actions": [{ "type": "key", "id": "keyboard", "actions": all }] }));
    }

    /// Log entries since the last call: `browser` is the console, `performance` contains the requests.
    pub(crate) fn log(&self, kind: &str) -> Vec<Value> {
        self.post("/se/log", &json!({ "type": kind })).as_array().unwrap().clone()
    }

    /// Runs a command of the Chrome DevTools Protocol.
    pub(crate) fn devtools(&self, command: &str, params: &Value) -> Value {
        self.post("/goog/cdp/execute", &json!({ "cmd": command, "params": params }))
    }

    fn post(&self, path: &str, body: &Value) -> Value {
        self.ask(path, body).unwrap()
    }

    fn ask(&self, path: &str, body: &Value) -> Result<Value, String> {
        let request = self.client.post(format!("{}{path}", self.session)).content_type("application/json");
        value(request.send(body.to_string()))
    }
}

/// The `value` of a response, or the browser's message if it is an error.
fn value(answer: Result<Response<Body>, ureq::Error>) -> Result<Value, String> {
    let answer = answer.unwrap();
    let status = answer.status();
    let mut json: Value = serde_json::from_reader(BufReader::new(answer.into_body().into_reader())).unwrap();
    if status.is_success() { Ok(json["value"].take()) } else { Err(format!("{status}: {}", json["value"]["message"])) }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // Deleting the session closes Chromium, which would survive if only the driver were killed.
        let ended = self.client.delete(&self.session).call();
        // While a failed test unwinds, a second panic would abort the process before its folders are removed.
        if !std::thread::panicking() {
            value(ended).unwrap();
        }
        let _ = self.driver.kill();
        let _ = self.driver.wait();
    }
}

impl Element<'_> {
    pub(crate) fn click(&self) {
        self.browser.post(&format!("/element/{}/click", self.id), &json!({}));
    }

    /// Focuses the element and types into it; special keys are private-use code points of the protocol.
    pub(crate) fn press(&self, keys: &str) {
        self.browser.post(&format!("/element/{}/value", self.id), &json!({ "text": keys }));
    }

    /// Presses the mouse button so many pixels beside the element's center, moves it by this many, and releases it.
    pub(crate) fn drag(&self, from: [i64; 2], by: [i32; 2]) {
        let middle = json!({ "type": "pointerMove", "origin": { ELEMENT: self.id }, "x": from[0], "y": from[1] });
        let moved = json!({ "type": "pointerMove", "origin": "pointer", "x": by[0], "y": by[1] });
        let [down, up] = ["pointerDown", "pointerUp"].map(|kind| json!({ "type": kind, "button": 0 }));
        let actions = json!([{ "type": "pointer", "id": "mouse", "actions": [middle, down, moved, up] }]);
        self.browser.post("/actions", &json!({ "actions": actions }));
    }

    /// The element's accessible name, as screen readers announce it.
    pub(crate) fn label(&self) -> String {
        let url = format!("{}/element/{}/computedlabel", self.browser.session, self.id);
        value(self.browser.client.get(url).call()).unwrap().as_str().unwrap().to_owned()
    }
}

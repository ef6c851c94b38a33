//! The web page in a real browser, with a real run: it shows the recorded numbers, updates live, plays episodes, and
//! reconnects.

use std::process::Command;

use crate::support::line::Line;
use crate::support::played::{errors, played};
use crate::support::served::{Process, endless, interrupt, page};
use crate::support::webdriver::{Browser, ENTER, RIGHT};
use blueprints::Catalog;
use runlog::{Evaluation, History, RunPaths};
use serde_json::{Value, json};

/// Maximum size of the page without its history and episodes, in bytes. A third of it is for 3D.
const MAX_PAGE_BYTES: u64 = 500_000;

/// Whether the page says when the run will be done.
const IS_ESTIMATED: &str = "document.querySelector('#tiles').textContent.includes(' to go')";

/// The ids of controls that a user can press and that need the program.
fn enabled(browser: &Browser) -> Vec<String> {
    let all =
        "[...document.querySelectorAll(`#stage-bar button, #stage-bar input, #replay-ask, #draw-open, #draw-policy,
        #draw-expert, #draw-match, #draw-file, #draw-copy, #videos button`)]";
    let ids = browser.run(&format!("return {all}.filter((one) => !one.matches(':disabled')).map((one) => one.id)"));
    serde_json::from_value(ids).unwrap()
}

/// A run, a browser that shows its page, and the connection between them.
struct Watched {
    // Fields are dropped in this order.
    browser: Browser,
    line: Line,
    run: Process,
    folder: tempfile::TempDir,
}

impl Watched {
    /// Returns `None` if `LODESTONE_CHROMEDRIVER` names no driver; `.ci/run` installs one.
    fn start() -> Option<Self> {
        let Some(driver) = std::env::var_os("LODESTONE_CHROMEDRIVER") else {
            eprintln!("LODESTONE_CHROMEDRIVER names no chromedriver, so no browser looked at the page");
            return None;
        };
        let folder = tempfile::tempdir().unwrap();
        // Its output is dropped; the run continues with a closed stdout.
        let (run, _, address) = endless(folder.path());
        let line = Line::to(&address);
        let browser = Browser::start(&driver, folder.path(), &format!("http://{}/", line.address()));
        Some(Self { browser, line, run, folder })
    }

    fn evaluations(&self) -> Vec<Evaluation> {
        History::read(&RunPaths::new(self.folder.path().join("run")).history()).unwrap()
    }

    /// Waits for the page to show an evaluation of weights newer than `version`; returns their version.
    fn evaluated_after(&self, version: u64) -> u64 {
        let shown = "Number((/weights (\\d+)/.exec(document.querySelector('#groups caption')?.textContent) || [])[1])";
        self.browser.until(&format!("({shown}) > {version} && ({shown})")).as_u64().unwrap()
    }

    /// The URLs that the page has requested since the last call.
    fn requests(&self) -> Vec<String> {
        let events = self.browser.log("performance").into_iter().map(|entry| {
            let event: Value = serde_json::from_str(entry["message"].as_str().unwrap()).unwrap();
            event["message"].clone()
        });
        let sent = events.filter(|event| event["method"] == "Network.requestWillBeSent");
        // The browser's first tab has its own page, with files that do not come from the network.
        let is_ours = |event: &Value| !event["params"]["documentURL"].as_str().unwrap().starts_with("chrome:");
        let sent = sent.filter(is_ours);
        sent.map(|event| event["params"]["request"]["url"].as_str().unwrap().to_owned()).collect()
    }

    /// Warnings and errors in the console since the last call.
    fn complaints(&self) -> Vec<Value> {
        let entries = self.browser.log("browser").into_iter();
        // Where evaluations are this short, a newer video may replace one before the page gets its first picture.
        let replaced = |entry: &Value| {
            entry["message"].as_str().is_some_and(|text| text.contains("/api/poster?") && text.contains("404"))
        };
        let counts = |entry: &Value| entry["level"] == "SEVERE" || entry["level"] == "WARNING";
        entries.filter(|entry| counts(entry) && !replaced(entry)).collect()
    }
}

/// Formats a rate as the page does.
fn percent(rate: f64) -> String {
    let digits = usize::from(rate > 0.0 && rate < 1.0);
    format!("{:.digits$} %", 100.0 * rate)
}

#[test]
fn the_page_shows_what_was_recorded_and_goes_on_by_itself() {
    let Some(watched) = Watched::start() else { return };
    let browser = &watched.browser;
    let first = watched.evaluated_after(0);
    let loaded = "[...performance.getEntriesByType('navigation'), ...performance.getEntriesByType('resource')]
        .filter((entry) => !entry.name.includes('/api/')).map((entry) => entry.transferSize)";
    let sizes: Vec<u64> = serde_json::from_value(browser.run(&format!("return {loaded}"))).unwrap();
    // The page, its style sheet, and its script; a headless browser may skip the icon.
    assert!(sizes.len() >= 3 && sizes.iter().all(|size| *size > 0), "{sizes:?}");
    assert!(sizes.iter().sum::<u64>() < MAX_PAGE_BYTES, "{sizes:?}");

    // A newer evaluation appears in the same document: a reload would lose the mark.
    browser.run("window.mark = true");
    watched.evaluated_after(first);
    assert_eq!(browser.run("return window.mark"), true);

    // Read everything in one script, because the next evaluation may arrive at any time.
    let shown = browser.run(
        "return [document.querySelector('#groups caption').textContent,
                 ...document.querySelector('#groups tbody tr:last-child').children].map((cell) => cell.textContent || cell)",
    );
    let shown: Vec<String> = serde_json::from_value(shown).unwrap();
    let version: u64 = shown[0].split(['s', ',']).find_map(|word| word.trim().parse().ok()).unwrap();
    let evaluation =
        watched.evaluations().into_iter().find(|evaluation| evaluation.weights_version.0 == version).unwrap();
    let success = evaluation.blueprints[0].greedy.success;
    assert_eq!((evaluation.blueprints.len(), success.n_episodes), (1, 2));
    let interval = format!("{} to {}", percent(success.wilson_low), percent(success.wilson_high));
    let expected = ["all", "1", &percent(success.rate), &interval, "2"];
    assert_eq!(shown[1..], expected, "{shown:?}");

    // The heat map gives the same numbers to keyboard users.
    browser.element("#heat").press(RIGHT);
    let text = browser.text("#heat-cell");
    let is_shown = |evaluation: &Evaluation| {
        let success = evaluation.blueprints[0].greedy.success;
        let words = format!("{} of {} episodes ({})", success.n_successes, success.n_episodes, percent(success.rate));
        text.starts_with("5_001, train, 5 blocks, after ") && text.ends_with(&words)
    };
    assert!(watched.evaluations().iter().any(is_shown), "{text}");
    browser.until("document.querySelectorAll('#health .spark').length >= 6");
    browser.until("document.querySelector('#roster').textContent.includes('actor ')");

    assert_eq!(watched.complaints(), Vec::<Value>::new());
    let requests = watched.requests();
    let origin = format!("http://{}/", watched.line.address());
    // The browser's own pages and pictures, such as its first tab and the controls of videos, cause no network traffic.
    let is_own = |url: &str| ["data:", "chrome:", "chrome-untrusted:"].iter().any(|scheme| url.starts_with(scheme));
    let is_elsewhere = |url: &&String| !url.starts_with(&origin) && !is_own(url);
    let elsewhere: Vec<_> = requests.iter().filter(is_elsewhere).collect();
    assert!(requests.len() >= 5 && elsewhere.is_empty(), "{requests:?}");
}

#[test]
fn an_episode_plays_and_is_turned_and_stepped() {
    let Some(watched) = Watched::start() else { return };
    let browser = &watched.browser;
    browser.element("#replay-ask").click();
    browser.until("replay.episode?.actor === 'local'");
    let picture = || browser.run("return document.querySelector('#replay').toDataURL()");
    let step = || browser.run("return Number(document.querySelector('#replay-slider').value)").as_u64().unwrap();
    let says =
        |words: &str| browser.until(&format!("document.querySelector('#replay-play').textContent === {words:?}"));
    // The episode plays by itself and stops at the end.
    says("Play");
    let n_steps = step();
    assert!(browser.text("#replay-text").starts_with(&format!("step {n_steps} of {n_steps}, ")));

    // The slider goes back to the start, where no reward has been earned yet; at the end, the terms add up to the
    // total.
    let scrub = |to: u64| {
        browser.run(&format!(
            "const slider = document.querySelector('#replay-slider');
             slider.value = {to};
             slider.dispatchEvent(new Event('input'));"
        ));
        let values =
            "return [...document.querySelectorAll('#replay-values dd')].map((value) => Number(value.textContent))";
        serde_json::from_value::<Vec<f64>>(browser.run(values)).unwrap()
    };
    let terms = scrub(n_steps);
    assert!((terms[0] - terms[1..].iter().sum::<f64>()).abs() < 0.05, "{terms:?}");
    assert!(browser.text("#replay-text").contains(&format!("reward {:.2}", terms[0])));
    browser.until("document.querySelector('#replay-terms canvas')");
    assert_eq!(browser.run("return document.querySelectorAll('#replay-values .dot').length"), 6);
    assert_eq!(scrub(0), [0.0; 6]);

    // Zoom out first, because an untrained policy throws blocks out of the picture.
    let near = picture();
    browser.element("#replay").press("--------");
    let first = picture();
    assert_ne!(first, near);
    // The first step draws frames around the blocks that the grippers pick up.
    browser.element("#replay-forth").click();
    assert_eq!(step(), 1);
    assert_ne!(picture(), first);
    browser.element("#replay-back").click();
    assert_eq!((step(), picture()), (0, first.clone()));
    browser.element("#replay-play").click();
    browser.until(&format!("document.querySelector('#replay').toDataURL() !== {first}"));
    says("Play");
    assert_eq!(step(), n_steps);
    let end = picture();
    browser.element("#replay").drag([0, 0], [80, 20]);
    let turned = picture();
    assert_ne!(turned, end);
    browser.element("#replay").press(RIGHT);
    assert_ne!(picture(), turned);
    assert_eq!(watched.complaints(), Vec::<Value>::new());
    check_names_and_widths(&watched);
}

/// Checks that everything on a page that shows an episode has a name for screen readers, and fits on a phone.
fn check_names_and_widths(watched: &Watched) {
    let browser = &watched.browser;
    watched.evaluated_after(0);
    browser.element("#draw-open").click();
    browser.until("document.querySelector('#draw-palette button')");
    // Without new data, nothing is redrawn, so elements stay valid while they are checked.
    watched.line.cut();
    // A busy page may come to look only after the second miss.
    browser.until("['reconnecting', 'no answer'].includes(document.querySelector('#state').textContent)");
    let all = "main section, main button, main input, main [role=img], .scroll";
    let named = browser.elements(&format!(":is({all}):not([hidden], [hidden] *, details:not([open]) *)"));
    assert!(named.len() > 20, "{}", named.len());
    for element in named {
        assert_ne!(element.label(), "");
    }
    for (width, height) in [(390, 844), (768, 844), (1280, 844), (1920, 1080)] {
        let metrics = json!({ "width": width, "height": height, "deviceScaleFactor": 2, "mobile": width < 500 });
        browser.devtools("Emulation.setDeviceMetricsOverride", &metrics);
        // Charts take their new width a frame later.
        browser.until("document.documentElement.scrollWidth === document.documentElement.clientWidth");
    }
}

#[test]
fn play_opens_with_a_structure_being_built() {
    let folder = tempfile::tempdir().unwrap();
    let Some((browser, _playing)) = played(folder.path(), &["2_000"]) else { return };
    // The page starts without a click and shows nothing about a training.
    browser.until("!document.querySelector('#replay-player').hidden && replay.time > 0");
    let note = |words: &str| {
        browser.until(&format!("document.querySelector('#replay-note').textContent.startsWith({words:?})"));
    };
    note("The policy builds ");
    assert!(browser.text("#replay-note").contains("(2_000), start 1"), "{}", browser.text("#replay-note"));
    assert_eq!(browser.run("return document.querySelector('#learner, #members, #dropped')"), Value::Null);
    // Otherwise the page would move on by itself during the checks below.
    browser.element("#stage-onward").click();
    browser.element("#stage-again").click();
    browser.until("document.querySelector('#replay-note').textContent.includes('(2_000), start 2')");
    browser.element("#stage-agent input[value=expert]").click();
    note("The expert builds ");
    // The note appears before the episode.
    browser.until("replay.episode.actor === 'expert' && !replay.playing && replay.time >= replay.n");
    assert_eq!(browser.text("#replay-play"), "Play");
    assert!(browser.text("#replay-text").ends_with("success"), "{}", browser.text("#replay-text"));
    assert!(browser.text("#replay-verdict").starts_with("Built: 1 of 1 connection in "));
    assert_eq!(browser.run("return document.querySelector('#replay-verdict').className"), "verdict good");
    // The structure stays in the picture the whole time and fills it at the end.
    for (width, device) in [(390, 2), (1280, 1)] {
        let metrics = json!({ "width": width, "height": 844, "deviceScaleFactor": device, "mobile": width < 500 });
        browser.devtools("Emulation.setDeviceMetricsOverride", &metrics);
        browser.until(&format!("replay.main.space.size[0] < {width} && replay.main.space.size[0] > 0.8 * {width}"));
        let camera: [f64; 4] = serde_json::from_value(browser.run(include_str!("camera.js"))).unwrap();
        assert!(camera[0] == 0.0 && camera[1] < 0.5 && (0.4..=1.0).contains(&camera[2]), "{camera:?} at {width}");
        assert!(camera[3] >= 0.0, "the goal hides something: {camera:?} at {width}");
    }
    browser.run(
        "const { space, episode: { goal }, label } = replay.main;
         const { x, y } = space.blocks[goal[0][0]].position.clone().project(space.camera);
         label.point([((1 + x) / 2) * space.size[0], ((1 - y) / 2) * space.size[1]])",
    );
    let label = browser.text("#replay-label");
    assert!(
        label.starts_with("cube ") && label.contains(", 1×1×1 · ") && label.contains("1 of 1 connection"),
        "{label}"
    );
    // Also while no source of attention is chosen.
    assert!(label.contains(" · attends most to ") && !label.contains("of the attention"), "{label}");
    assert_eq!(browser.run(include_str!("verdict.js")), json!([]));

    // The gallery shows every blueprint, can be searched, and opens a blueprint.
    browser.element("#stage-choose").click();
    let n_blueprints = Catalog::builtin().len();
    browser.until(&format!("document.querySelectorAll('#gallery button img').length === {n_blueprints}"));
    let n_large = Catalog::builtin().iter().filter(|blueprint| blueprint.n_blocks() == 16).count();
    browser.element("#gallery input").press("16 blocks");
    browser.until(&format!("document.querySelectorAll('#gallery button img').length === {n_large}"));
    browser.run("document.querySelector('#gallery input').value = ''");
    browser.element("#gallery input").press("16_002");
    browser.until("document.querySelectorAll('#gallery button img').length === 1");
    browser.until("document.querySelector('#gallery img').naturalWidth === 200");
    browser.element("#gallery .gallery button").click();
    browser.until("document.querySelector('#replay-note').textContent.includes('(16_002), start 1')");
    // The structure that stands there can be kept.
    browser.element("#stage-keep").click();
    browser.element("#stage-next").click();
    browser.until("document.querySelector('#replay-note').textContent.includes('(2_000), start 1, goal 2 of 10')");
    browser.element("#stage-again").click();
    browser.until("document.querySelector('#replay-note').textContent.endsWith('(2_000), start 2')");
    assert_eq!(errors(&browser), Vec::<Value>::new());
}

#[test]
fn what_is_drawn_is_checked_and_built() {
    let folder = tempfile::tempdir().unwrap();
    // A user's own file, which no evaluator knows.
    let own = Catalog::builtin().get(&"2_000".parse().unwrap()).unwrap().to_toml("a test").replace("2_000", "2_900");
    std::fs::write(folder.path().join("own.toml"), own).unwrap();
    let Some((browser, _playing)) = played(folder.path(), &["--blueprint", "own.toml"]) else { return };
    let says =
        |words: &str| browser.until(&format!("document.querySelector('#draw-say').textContent.includes({words:?})"));
    browser.until("document.querySelector('#replay-note').textContent.includes('(2_900), start 1')");
    browser.element("#draw-open").click();
    // The center of the canvas is the center of the grid.
    // Each answer to a check draws the palette anew.
    browser.until("editor.found.blocks && document.querySelector('#draw-palette [data-type=\"2x1x1\"]')");
    browser.element("#draw-palette [data-type='2x1x1']").click();
    browser.element("#draw-canvas").click();
    browser.until("editor.blocks.length === 1 && editor.found.blocks.length === 1");
    // A dragged block moves along the floor, and the view stays.
    browser.element("#draw-palette button:first-child").click();
    let place = "JSON.stringify([editor.blocks[0].at, editor.desk.camera.position])";
    let before = browser.run(&format!("return {place}"));
    browser.element("#draw-canvas").drag([0, 0], [200, 0]);
    browser.until("editor.blocks[0].at[0] > 0");
    browser.run("editor.act('undo')");
    assert_eq!(browser.run(&format!("return {place}")), before);
    // With the keyboard, a block goes on top of the previous one.
    browser.element("#draw-palette [data-type='1x1x1']").click();
    browser.element("#draw-canvas").press(ENTER);
    says("2 blocks, 1 connection. It can be built.");
    // A long block that is tipped over stands.
    browser.run("editor.pick(0); editor.act('tip')");
    let height = "editor.cells(editor.blocks[0].type, editor.blocks[0].axes)[2]";
    assert_eq!(browser.run(&format!("return {height}")), 2);
    browser.run("editor.act('undo')");
    assert_eq!(browser.run(&format!("return {height}")), 1);
    browser.run("editor.act('redo')");
    assert_eq!(browser.run(&format!("return {height}")), 2);
    browser.run("editor.act('undo'); editor.pick(1)");
    says("It can be built.");
    // Upside down, like poles face each other.
    browser.element("#draw-canvas").press("tt");
    browser.until("document.querySelector('#draw-problems').textContent.includes('repel each other: like poles meet')");
    assert_eq!(browser.run("return document.querySelector('#draw-expert').disabled"), true);
    // A file that cannot be opened is not blamed for that.
    browser.run("editor.load('no blueprint')");
    says("This file cannot be opened: ");
    assert_eq!(browser.text("#draw-problems"), "");
    // The browser itself logs that answer.
    assert!(errors(&browser).iter().all(|entry| entry["source"] == "network"));
    browser.element("#draw-match").click();
    says("It can be built.");
    browser.element("#draw-name").press("my tower");
    browser.until("document.querySelector('#draw-name').value === 'my tower'");
    browser.element("#draw-expert").click();
    browser.until("replay.episode && replay.episode.blueprint.startsWith('drawn_2_')");
    assert_eq!(browser.run("return replay.episode.end"), "success");
    assert!(browser.text("#replay-note").starts_with("The expert builds my tower"), "{}", browser.text("#replay-note"));
    // At the end, the picture turns it upright, as it was drawn.
    let heights = "replay.episode.goal.map(([block, pose]) => replay.main.space.blocks[block].position.z - pose[2])";
    browser.until(&format!("replay.after > 13 && {heights}.every((z, _, all) => Math.abs(z - all[0]) < 0.02)"));
    // The server makes its video, and its address shows it again, also where nobody has drawn it.
    browser.run("URL.createObjectURL = (content) => { window.content = content; return '#saved'; }");
    browser.element("#stage-video").click();
    browser.until("window.content?.type === 'video/mp4'");
    let link = browser.run("return location.href").as_str().unwrap().to_owned();
    browser.open("about:blank");
    browser.open(&link);
    browser.until("replay.episode?.blueprint.startsWith('drawn_2_')");
    assert!(browser.text("#replay-note").starts_with("The expert builds my tower"), "{link}");
    assert_eq!(errors(&browser), Vec::<Value>::new());
    browser.open(&link.replace("2x1x1,", "2x9x1,"));
    browser.until("document.querySelector('#replay-note').textContent.startsWith('This drawing cannot be built: ')");
}

#[test]
fn a_draft_is_opened_turned_undone_and_saved_under_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let Some((browser, _playing)) = played(folder.path(), &["2_000"]) else { return };
    let says =
        |words: &str| browser.until(&format!("document.querySelector('#draw-say').textContent.includes({words:?})"));
    browser.element("#draw-open").click();
    browser.until("editor.desk && editor.found.blocks");
    // Two blocks in one place, and one of a type that does not exist.
    let draft = "blocks = [\n    { type = \"2x1x1\", at = [4, 0, 0], axes = \"+x +y\" }, # the foot\n    { type = \
                 \"1x1x1\", at = [4, 0, 0] },\n    { type = \"9x9x9\", at = [0, 0, 0] },\n]\n";
    let path = folder.path().join("my draft.toml");
    std::fs::write(&path, draft).unwrap();
    browser.element("#draw-file").press(path.to_str().unwrap());
    browser.until("document.querySelector('#draw-problems').textContent.includes('overlap')");
    says("This file is a draft: ");
    says("1 block is left out. 2 blocks, 0 connections.");
    let name = || browser.run("return document.querySelector('#draw-name').value");
    assert_eq!(name(), "my draft");
    let height = "editor.cells(editor.blocks[0].type, editor.blocks[0].axes)[2]";
    let act = |what: &str| {
        browser.run(&format!("editor.act({what:?})"));
        browser.run(&format!("return {height}"))
    };
    browser.run("editor.pick(0)");
    assert_eq!([act("stand"), act("stand"), act("lie"), act("undo"), act("undo")], [2, 2, 1, 2, 1].map(Value::from));
    // What would be saved, as its name and its text.
    browser.run(
        "URL.createObjectURL = (content) => { window.content = content; return '#saved'; };
         HTMLAnchorElement.prototype.click = function () { window.fileName = this.download; };",
    );
    let saved = || {
        browser.element("#draw-save").click();
        browser.run("return [window.fileName, await window.content.text()]")
    };
    let [file, text]: [String; 2] = serde_json::from_value(saved()).unwrap();
    assert_eq!(file, "my draft.toml");
    assert!(text.contains("title = \"my draft\"") && text.contains("type = \"1x1x1\", at = [-1, 0, 0]"), "{text}");
    // The name given is that of the file, and can be taken back, as the opening of the file can.
    browser.element("#draw-name").press(" two");
    browser.run("editor.pick(1); for (const _ of [0, 1]) editor.act('up')");
    browser.until("document.querySelector('#draw-problems').textContent.includes('not connected')");
    assert_eq!(saved()[0], "my draft two.toml");
    browser.run("for (const _ of [0, 1, 2]) editor.act('undo')");
    assert_eq!((name(), saved()[0].clone()), (json!("my draft"), json!("my draft.toml")));
    browser.run("editor.act('undo')");
    assert_eq!((name(), browser.run("return editor.blocks.length")), (json!(""), json!(0)));
    // The browser itself logs the answer that the file is no blueprint.
    assert!(errors(&browser).iter().all(|entry| entry["source"] == "network"));
}

#[test]
fn a_video_becomes_an_episode_with_its_goal_in_place_and_its_attention() {
    let Some(watched) = Watched::start() else { return };
    let browser = &watched.browser;
    // At once, because a newer video replaces the buttons.
    let buttons = "[...document.querySelectorAll('#videos figure:first-child button')]";
    browser.until(&format!("{buttons}.map((button) => button.click()).length"));
    // The page has opened with another episode.
    let is_told = "document.querySelector('#replay-note').textContent.includes(' in an evaluation of weights ')";
    browser.until(&format!("{is_told} && replay.episode && !document.querySelector('#replay-player').hidden"));
    browser.run("replay.play(false)");
    assert!(browser.text("#replay-note").contains(" (5_001), "), "{}", browser.text("#replay-note"));
    let picture = || browser.run("return document.querySelector('#replay').toDataURL()");
    let choose = |eye: &str| {
        browser.run(&format!(
            "const eye = document.querySelector('#replay-eye');
             eye.value = [...eye.options].find((option) => option.textContent === {eye:?}).value;
             eye.dispatchEvent(new Event('change'));"
        ));
        picture()
    };
    // Zoom out, so that the goal is in the picture wherever it is being built.
    browser.element("#replay").press("--------");
    let with_goal = picture();
    browser.element("#replay-ghost").click();
    let plain = picture();
    assert_ne!(plain, with_goal);
    // One row for each of the five blocks and one for all others, and one column per scene.
    let shaded = choose("layer 1, head 1");
    assert_ne!(shaded, plain);
    assert_ne!(choose("gripper 2"), plain);
    let cells = browser.run("return document.querySelectorAll('#replay-strip rect').length").as_u64().unwrap();
    let n_scenes = browser.run("return Number(document.querySelector('#replay-slider').max) + 1").as_u64().unwrap();
    assert_eq!(cells, 6 * (n_scenes + 1));
    assert_eq!(choose("off"), plain);
    assert_eq!(browser.run("return document.querySelector('#replay-strip').hidden"), true);
    assert_eq!(watched.complaints(), Vec::<Value>::new());
}

#[test]
fn a_page_that_loses_its_run_finds_it_again_and_says_when_it_has_ended() {
    let Some(watched) = Watched::start() else { return };
    let browser = &watched.browser;
    let state = |text: &str| browser.until(&format!("document.querySelector('#state').textContent === {text:?}"));
    state("live");
    let before = watched.evaluated_after(0);
    browser.until(IS_ESTIMATED);
    assert_eq!(watched.complaints(), Vec::<Value>::new());
    browser.run(
        "[window.mark, window.states] = [true, []];
         const note = ([{ target }]) => window.states.push(target.textContent);
         new MutationObserver(note).observe(document.querySelector('#state'), { childList: true })",
    );
    watched.line.cut();
    state("no answer");
    assert_eq!(browser.run("return window.states"), json!(["reconnecting", "no answer"]));
    // What was already shown stays visible, but nothing is about to come.
    assert!(browser.text("#groups caption").contains("weights"));
    browser.until(&format!("!({IS_ESTIMATED})"));
    // A run that was killed looks the same from here.
    browser.until("!document.querySelector('#farewell').hidden");
    let said = browser.text("#farewell");
    assert!(said.starts_with("The run may have ended: nothing answers.") && said.ends_with(" serve run"), "{said}");
    assert_eq!(enabled(browser), Vec::<String>::new());
    watched.line.mend();
    state("live");
    assert_eq!(browser.run("return document.querySelector('#farewell').hidden"), true);
    assert!(enabled(browser).contains(&"replay-ask".to_owned()));
    browser.until(IS_ESTIMATED);
    watched.evaluated_after(before);
    assert_eq!(browser.run("return window.mark"), true);
    // The browser itself logs what it could not load; the page must not log anything else.
    let complaints = watched.complaints();
    assert!(complaints.iter().all(|entry| entry["source"] == "network"), "{complaints:?}");
    check_end(watched);
}

/// Ends a run that its page has shown for a while: the page says so, and how to see the run again.
fn check_end(mut watched: Watched) {
    let browser = &watched.browser;
    interrupt(&watched.run);
    browser.until("document.querySelector('#state').textContent === 'ended'");
    assert!(watched.run.0.wait().unwrap().success());
    let said = browser.text("#farewell");
    assert!(said.starts_with("The run has ended. The page keeps what it has until you reload it."), "{said}");
    assert!(browser.text("#groups caption").contains("weights"));
    browser.until(&format!("!({IS_ESTIMATED})"));
    assert_eq!(enabled(browser), Vec::<String>::new());
    let reason = "document.querySelector('#replay-ask').closest('[title]').title";
    assert_eq!(browser.run(&format!("return {reason}")), "The run has ended.");
    // Not every control is a button.
    browser.run("heat.move({ row: 0, column: 0 }); heat.open()");
    browser.until("document.querySelector('#replay-note').textContent === 'The run has ended.'");
    // A shell reads the command as it stands there.
    let mut shell = Command::new("bash");
    shell.args(["-c", &format!("exec {}", browser.text("#farewell code"))]).current_dir(watched.folder.path());
    let (again, _printed, address) = page(&mut shell);
    browser.open(&format!("http://{address}"));
    browser.until("document.querySelector('#state').textContent === 'finished'");
    // The run was interrupted, and nothing continues it.
    browser.until("document.querySelector('#tiles').textContent.includes('environment steps')");
    assert_eq!(browser.run(&format!("return {IS_ESTIMATED}")), false);
    interrupt(&again);
    browser.until("document.querySelector('#state').textContent === 'ended'");
    let said = browser.text("#farewell");
    assert!(said.starts_with("The program has ended. ") && said.ends_with(" serve run"), "{said}");
}

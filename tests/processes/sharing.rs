//! The page for everyone: a link shows what its sender saw, the keyboard alone suffices, and axe-core finds no serious
//! fault.

use std::path::Path;

use serde_json::{Value, json};

use crate::support::played::{errors, played};
use crate::support::program::lodestone;
use crate::support::served::{page, train};
use crate::support::webdriver::{Browser, ENTER, RIGHT, TAB};

#[test]
fn a_link_shows_the_same_picture() {
    let folder = tempfile::tempdir().unwrap();
    let Some((browser, _playing)) = played(folder.path(), &["2_000", "2_001"]) else { return };
    let shows =
        |id: &str, step: f64| browser.until(&format!("replay.episode?.blueprint === '{id}' && replay.time === {step}"));
    let address = || browser.run("return location.href").as_str().unwrap().to_owned();
    let picture = || browser.run("return document.querySelector('#replay').toDataURL()");
    browser.until("replay.episode?.blueprint === '2_000'");
    let here = address();
    let link = format!("{}?blueprint=2_001&agent=expert&seed=3&step=4", &here[..=here.rfind('/').unwrap()]);
    browser.open(&link);
    shows("2_001", 4.0);
    assert!(browser.text("#replay-note").starts_with("The expert builds step (2_001), start 4"));
    // A turned camera, a step, a hidden goal and the source of attention come back with the address.
    browser.element("#replay").press(&format!("{RIGHT}++."));
    browser.element("#replay-ghost").click();
    browser.until("location.search.includes('camera=') && location.search.includes('step=5')");
    let look = |source: &str| {
        let choose = "const eye = document.querySelector('#replay-eye'); eye.dispatchEvent(new Event('change'))";
        browser.run(&choose.replace("; ", &format!("; eye.value = {source}; ")));
    };
    look("2");
    browser.until("location.search.includes('goal=hidden') && location.search.includes('eye=2')");
    let (turned, seen) = (address(), picture());
    browser.open("about:blank");
    browser.open(&turned);
    shows("2_001", 5.0);
    assert_eq!(picture(), seen);
    // The back button leads to the episode before, from which it started.
    browser.element("#stage-previous").click();
    browser.until("replay.episode.blueprint === '2_000' && location.search.includes('blueprint=2_000')");
    look("-1");
    browser.run("setTimeout(() => history.back())");
    shows("2_001", 5.0);
    assert_eq!((address(), picture()), (turned, seen));
    // The server makes a video of the same episode.
    let video = "const answer = await fetch('/api/play.mp4?blueprint=2_001&agent=expert&seed=3');
        return [answer.headers.get('content-type'), new TextDecoder().decode((await answer.arrayBuffer()).slice(4, 8))]";
    assert_eq!(browser.run(video), json!(["video/mp4", "ftyp"]));
    // The policy and the expert build in step, and nothing follows by itself.
    browser.run("document.querySelector('#stage-onward').checked = false");
    browser.element("#stage-both").click();
    browser.until("replay.views.map(({ episode }) => episode.actor).join() === 'policy,expert'");
    browser.until("!replay.playing && location.search.includes('both=1')");
    assert!(browser.text("#beside-verdict").starts_with("Built: 1 of 1 connection in "));
    // The picture is of both, and the video says whose it is.
    browser.run(
        "URL.createObjectURL = (content) => { window.content = content; return '#saved'; };
         HTMLAnchorElement.prototype.click = function () { window.fileName = this.download; };",
    );
    browser.element("#replay-save").click();
    browser.until("window.fileName?.startsWith('2_001-policy-expert-step-')");
    let widths = "const { width } = await createImageBitmap(window.content);
        return [width, replay.views.reduce((sum, { parts }) => sum + parts.canvas.width, 0)]";
    let widths = browser.run(widths);
    assert_eq!(widths[0], widths[1]);
    browser.element("#stage-video").click();
    browser.until("window.fileName === '2_001-policy.mp4'");
    assert_eq!(browser.text("#stage-shared"), "This is the video of the left episode (policy).");
    browser.element("#stage-choose").click();
    browser.until("location.search.includes('open=gallery')");
    browser.run("setTimeout(() => history.back())");
    browser.until("!document.querySelector('#gallery').open");
    assert_eq!(errors(&browser), Vec::<Value>::new());
}

#[test]
fn a_training_shows_something_from_its_first_weights_on_and_a_link_names_them() {
    let Some(driver) = std::env::var_os("LODESTONE_CHROMEDRIVER") else { return };
    let folder = tempfile::tempdir().unwrap();
    let late = ["--steps", "1000000000", "--web", "127.0.0.1:0", "--set", "evaluator.every={steps=500000000}"];
    let (_run, _printed, address) = page(train(&mut lodestone(folder.path())).args(late));
    let browser = Browser::start(&driver, folder.path(), &format!("http://{address}/"));
    browser.until("document.querySelector('#tiles').textContent.includes('in training, nothing evaluated yet')");
    assert_eq!(browser.text("#curves"), "No evaluation yet; the first comes after 500 M environment steps.");
    let first = "document.querySelector('#health').firstElementChild?.textContent";
    browser.until(&format!("{first}.startsWith('success in training') && snapshots.all.length === 1"));
    let is_named = "replay.episode?.blueprint === '5_001' && location.search.includes(`weights=${replay.episode.weights_version}`)";
    browser.until(is_named);
    browser.open(&format!("http://{address}/?blueprint=5_001&step=0&weights=123456789"));
    browser.until(&format!("{is_named} && replay.time === 0"));
    let other = "` The link showed weights 123456789; these are ${replay.episode.weights_version}.`";
    browser.until(&format!("document.querySelector('#replay-note').textContent.endsWith({other})"));
    assert_eq!(errors(&browser), Vec::<Value>::new());
}

#[test]
fn a_disturbed_episode_goes_on_from_there_and_comes_back_with_its_link() {
    let folder = tempfile::tempdir().unwrap();
    let Some((browser, _playing)) = played(folder.path(), &["3_000"]) else { return };
    let address = || browser.run("return location.href").as_str().unwrap().to_owned();
    browser.until("replay.episode?.blueprint === '3_000'");
    let here = address();
    let link = format!("{}?blueprint=3_000&agent=expert&seed=3&step=9", &here[..=here.rfind('/').unwrap()]);
    browser.open(&link);
    browser.until("replay.episode?.actor === 'expert' && replay.time === 9");
    let scenes = |part: &str| browser.run(&format!("return JSON.stringify(replay.episode.scenes.slice({part}))"));
    let (start, rest) = (scenes("0, 10"), scenes("10"));
    let disturbed = |n: usize| browser.until(&format!("replay.episode.disturbances.length === {n}"));
    // The pointer takes hold of a block and lifts it.
    browser.element("#hand input[value=move]").click();
    let place = "const { space, episode } = replay.main;
        document.querySelector('#replay').scrollIntoView({ block: 'center' });
        const { x, y } = space.blocks[episode.goal[0][0]].position.clone().project(space.camera);
        return [(x / 2) * space.size[0], (-y / 2) * space.size[1]].map(Math.round)";
    let place: [i64; 2] = serde_json::from_value(browser.run(place)).unwrap();
    browser.element("#replay").drag(place, [10, -70]);
    disturbed(1);
    browser.until("location.search.includes('disturb=9,')");
    assert_eq!(scenes("0, 10"), start);
    assert_ne!(scenes("10"), rest);
    let moved = "const [[step, block]] = replay.episode.disturbances;
        const [before, after] = [step, step + 1].map((n) => replay.episode.scenes[n].blocks[block]);
        return apart3(before, after)";
    assert!(browser.run(moved).as_f64().is_some_and(|far_m| far_m > 0.05));
    // Another one is knocked without a pointer.
    browser.run("replay.play(false); replay.seek(12)");
    browser.element("#hand-push").click();
    disturbed(2);
    browser.until("!replay.playing && replay.time === replay.n && location.search.includes('step=')");
    assert!(browser.text("#hand-text").starts_with("Disturbed at step 9: "), "{}", browser.text("#hand-text"));
    let seen = scenes("0");
    let twice = address();
    browser.open("about:blank");
    browser.open(&twice);
    browser.until("replay.episode?.disturbances.length === 2");
    assert_eq!(scenes("0"), seen);
    // All of it can be taken back.
    browser.element("#hand-undo").click();
    disturbed(1);
    browser.element("#hand-undo").click();
    disturbed(0);
    assert_eq!((scenes("0, 10"), scenes("10")), (start, rest));
    assert_eq!(errors(&browser), Vec::<Value>::new());
    browser.open(&format!("{link}&disturb=4,99,1,0,0,0,0,0"));
    browser
        .until("document.querySelector('#replay-note').textContent.startsWith('disturb=4,99,1,0,0,0,0,0: expected ')");
}

#[test]
fn the_keyboard_alone_chooses_steps_and_draws() {
    let folder = tempfile::tempdir().unwrap();
    let Some((browser, _playing)) = played(folder.path(), &["2_000"]) else { return };
    let reach = |selector: &str| {
        let is_there = format!("return document.activeElement.matches({selector:?})");
        let found = (0..80).any(|_| {
            browser.keys(TAB);
            browser.run(&is_there) == true
        });
        assert!(found, "no number of tabs leads to {selector}");
    };
    browser.until("Boolean(replay.episode)");
    reach("#stage-choose");
    browser.keys(ENTER);
    browser.until("document.querySelectorAll('#gallery button img').length > 1");
    browser.keys("16_002");
    browser.until("document.querySelectorAll('#gallery button img').length === 1");
    reach("#gallery .gallery button");
    browser.keys(ENTER);
    browser.until("replay.episode.blueprint === '16_002'");
    reach("#replay");
    browser.run("replay.play(false); replay.seek(0)");
    browser.keys("..,");
    assert_eq!(browser.run("return replay.time"), 1);
    browser.keys(" ");
    browser.until("replay.time > 1");
    reach("#draw-open");
    browser.keys(ENTER);
    // Each answer to a check draws the palette anew.
    browser.until("editor.found.blocks && document.querySelector('#draw-palette [data-type=\"1x1x1\"]')");
    reach("#draw-palette [data-type='1x1x1']");
    // The canvas has the focus once a block is chosen.
    browser.keys(&format!("{ENTER}{ENTER}"));
    browser.until("editor.blocks.length === 1");
    assert_eq!(errors(&browser), Vec::<Value>::new());
}

/// The serious faults that axe-core finds on the page.
const FAULTS: &str = "
    const { violations } = await axe.run(document, { resultTypes: ['violations'] });
    const serious = violations.filter(({ impact }) => impact === 'serious' || impact === 'critical');
    return serious.flatMap(({ help, nodes }) => nodes.map(({ html }) => `${help}: ${html}`));
";

#[test]
fn the_page_has_no_serious_fault_for_anyone() {
    let axe = Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/page/node_modules/axe-core/axe.min.js");
    let Ok(axe) = std::fs::read_to_string(axe) else {
        eprintln!("`.ci/run page` has not installed axe-core, so it did not look at the page");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let Some((browser, _playing)) = played(folder.path(), &["2_000"]) else { return };
    browser.until("!document.querySelector('#replay-player').hidden");
    browser.element("#draw-open").click();
    browser.until("document.querySelector('#draw-palette button')");
    for scheme in ["light", "dark"] {
        let media = json!({ "features": [{ "name": "prefers-color-scheme", "value": scheme }] });
        browser.devtools("Emulation.setEmulatedMedia", &media);
        assert_eq!(browser.run(&format!("{axe}\n;{FAULTS}")), json!([]), "{scheme}");
    }
    browser.element("#stage-choose").click();
    browser.until("document.querySelector('#gallery img')");
    assert_eq!(browser.run(FAULTS), json!([]));
}

//! The web page for finished runs: several side by side, and a static copy that any web server can serve.

use std::path::Path;
use std::process::{Command, Stdio};

use runlog::RunPaths;
use serde_json::{Value, json};

use crate::support::played::errors;
use crate::support::program::{finished, lines, lodestone, names, printed_json};
use crate::support::served::{Process, get, page, train};
use crate::support::webdriver::{Browser, HOME};
use crate::support::written::write_sweep;

/// Creates two short runs in the folder, `first` and `second`. A run this short may end before any evaluation except
/// that of its last weights, so that one is enabled.
fn train_two(folder: &Path, settings: &[&str]) {
    for (name, seed) in [("first", "1"), ("second", "2")] {
        let mut command = lodestone(folder);
        let run = train(&mut command).args(["--set", "evaluator.evaluate_last=true"]).args(settings);
        finished(run.args(["--steps", "512", "--seed", seed, "--no-web"]));
        std::fs::rename(folder.join("run"), folder.join(name)).unwrap();
    }
}

/// Creates the run `run` in two trainings, because one that is fast may be evaluated only once.
fn train_on(folder: &Path) {
    let often = ["--set", "evaluator.every={versions=1}", "--set", "evaluator.evaluate_last=true"];
    finished(train(&mut lodestone(folder)).args(["--no-web", "--steps", "1024"]).args(often));
    finished(lodestone(folder).args(["train", "--resume", "run", "--no-web", "--steps", "2048"]));
}

/// Whether every chart has a curve of both runs.
const ARE_SIDE_BY_SIDE: &str = "document.querySelector('#curves canvas') && document.querySelector('#health canvas')
    && [...document.querySelectorAll('.charts .reading')].every((one) => /first .*second /.test(one.textContent))";

#[test]
fn finished_runs_stand_side_by_side_and_their_policies_play() {
    let Some(driver) = std::env::var_os("LODESTONE_CHROMEDRIVER") else { return };
    let folder = tempfile::tempdir().unwrap();
    train_two(folder.path(), &[]);
    // A run that ends makes no more videos, but keeps all recordings.
    let videos = folder.path().join("first/videos/5_001");
    let render = ["render", "first", "--fps", "10", "--out"];
    finished(lodestone(folder.path()).args(render).arg(&videos));
    for name in names(&videos) {
        std::fs::rename(videos.join(&name), videos.join(name.replace("5_001-", ""))).unwrap();
    }
    let (_server, _printed, address) = page(lodestone(folder.path()).args(["serve", "first", "second"]));
    let browser = Browser::start(&driver, folder.path(), &format!("http://{address}"));
    browser.until("document.querySelector('#state').textContent === 'finished'");
    let options =
        browser.run("return [...document.querySelectorAll('#run-name option')].map((one) => one.textContent)");
    assert_eq!(options, json!(["first", "second"]));
    browser.until(ARE_SIDE_BY_SIDE);
    assert_eq!(browser.run(include_str!("curves.js")), json!([]));
    // The heat map opens the recorded episode of the only evaluation.
    browser.until("heat.rows.length === 1 && heat.evaluations.length === 1");
    browser.run("heat.move({ row: 0, column: 0 }); heat.open()");
    browser.until("document.querySelector('#replay-note').textContent.includes(' in an evaluation of weights ')");
    // Other episodes are run on demand, by the policy of the selected run.
    browser.open(&format!("http://{address}/?run=1&axis=elapsed_s&smoothing=0.6"));
    browser.until("document.querySelector('#run-name select')?.value === '1'");
    browser.until("health.options.smoothing === 0.6 && document.querySelector('#chart-axis').value === 'elapsed_s'");
    browser.until("replay.episode?.blueprint === '5_001'");
    browser.element("#stage-next").click();
    browser.until("replay.episode.blueprint !== '5_001'");
    assert!(browser.text("#replay-note").starts_with("The policy builds "), "{}", browser.text("#replay-note"));
    assert_eq!(errors(&browser), Vec::<Value>::new());
}

#[test]
fn a_sweep_is_shown_before_its_runs() {
    let folder = tempfile::tempdir().unwrap();
    let sweep = folder.path().join("sweep");
    write_sweep(&sweep, &["0.9", "0.95"], 2);
    std::fs::write(sweep.join("point-2/seed-2.json"), r#"{"state":"failed","status":"exit status: 64"}"#).unwrap();
    finished(lodestone(folder.path()).args(["serve", "sweep", "--export", "copy"]));
    let (_server, _printed, address) = page(lodestone(folder.path()).args(["serve", "sweep"]));
    let answer = get(&address, "/api/sweep").1;
    assert_eq!(std::fs::read_to_string(folder.path().join("copy/api/sweep.json")).unwrap(), answer);
    let answer: Value = serde_json::from_str(&answer).unwrap();
    assert_eq!(answer["points"][1]["failed"][0]["log"], "point-2/seed-2.log");

    let Some(driver) = std::env::var_os("LODESTONE_CHROMEDRIVER") else { return };
    let browser = Browser::start(&driver, folder.path(), &format!("http://{address}"));
    // A chart of the only group, with a curve of either point, which one can leave out.
    let n_curves = "document.querySelectorAll('#sweep .reading .dot').length";
    browser.until(&format!("{n_curves} === 2"));
    let cells = browser.run("return [...document.querySelectorAll('#sweep tbody tr')].map((row) => row.innerText)");
    let expected = ["learner.gamma=0.9\t1 2\t100 %\n100 % to 100 %", "learner.gamma=0.95\t1\t100 %"];
    assert_eq!(cells, json!(expected));
    assert_eq!(
        browser.text("#sweep li"),
        "failed: learner.gamma=0.95, seed 2 (exit status: 64); see point-2/seed-2.log"
    );
    browser.element("#sweep tr:first-child input").click();
    // A chart of one curve has no key.
    browser.until(&format!("location.search === '?curves=2' && {n_curves} === 0"));
    browser.element("#sweep input[value=iqm]").click();
    assert!(browser.text("#sweep caption").contains("interquartile mean"));
    browser.until("location.search === '?curves=2&average=iqm'");
    // The second run that is done.
    browser.element("#sweep tr:nth-child(2) a").click();
    browser.until("document.querySelector('#run-name').textContent === 'learner.gamma=0.95, seed 1'");
    assert_eq!(errors(&browser), Vec::<Value>::new());
}

#[test]
fn snapshots_of_a_run_build_from_the_same_start_one_after_another_and_side_by_side() {
    let Some(driver) = std::env::var_os("LODESTONE_CHROMEDRIVER") else { return };
    let folder = tempfile::tempdir().unwrap();
    train_on(folder.path());
    let kept: Vec<u64> = RunPaths::new(folder.path().join("run")).snapshots().into_keys().collect();
    let first = kept[0];
    let last = kept[kept.len() - 1];
    assert!(first < last, "{kept:?}");
    let (_server, _printed, address) = page(lodestone(folder.path()).args(["serve", "run"]));
    let address = format!("http://{address}/");
    let browser = Browser::start(&driver, folder.path(), &format!("{address}?blueprint=2_000&seed=3&snapshot={last}"));
    let builds = |after: u64| {
        let caption = format!("replay.episode?.caption?.startsWith('policy after {after} steps')");
        browser.until(&format!("snapshots.all.length > 0 && {caption}"));
        browser.run("return [replay.episode.weights_version, replay.episode.scenes[0].blocks]")
    };
    let of_last = builds(last);
    let slider = browser.element("#snapshot");
    // The slider goes back to the first one, which builds from the same start.
    slider.press(HOME);
    let of_first = builds(first);
    assert_eq!(of_first[1], of_last[1]);
    assert_ne!(of_first[0], of_last[0]);
    browser.until(&format!("location.search.includes('seed=3') && location.search.includes('snapshot={first}')"));
    // Beside it builds the policy of the run, with its own weights, in step.
    browser.element("#snapshot-beside").click();
    browser.until("replay.views[1]?.episode.caption === `the run's policy`");
    let both = browser.run("return replay.views.map(({ episode }) => episode.weights_version)");
    assert_eq!(both[0], of_first[0]);
    browser.until("location.search.includes('beside=policy')");
    browser.element("#snapshot-beside").click();
    browser.until("replay.views.length === 1");
    // All of them follow each other, up to the policy of the run.
    browser.element("#snapshot-through").click();
    browser.until("snapshots.isThrough && replay.episode.scenes.length > 0");
    browser.run("setInterval(() => { if (replay.playing) replay.seek(replay.n); }, 50)");
    browser.until("!snapshots.isThrough && snapshots.chosen === null && replay.time === replay.n");
    // A link to one that is not there says so.
    browser.open(&format!("{address}?blueprint=2_000&snapshot=1"));
    browser.until("document.querySelector('#replay-note').textContent.startsWith('there is no snapshot after 1 ')");
    assert!(errors(&browser).iter().all(|entry| entry["source"] == "network"));
    // Other commands read a snapshot as well.
    let kept = format!("run/snapshots/{first}.safetensors");
    let eval = ["eval", "--episodes", "1", "--blueprint", "2_000"];
    let report = printed_json(lodestone(folder.path()).args(eval).args(["--json", "--checkpoint", &kept]));
    assert_eq!(report["summary"]["n_env_steps"], first);
    check_choices(&browser, &address);
}

/// Checks that choices come back with the address, and that what is used is on the screen.
fn check_choices(browser: &Browser, address: &str) {
    let address =
        format!("{address}?find=5_0&actions=sampled&log=y&zoom=100,600&whole=1&blueprint=2_000&agent=expert&step=0");
    for width in [1280, 390] {
        let metrics = json!({ "width": width, "height": 844, "deviceScaleFactor": 1, "mobile": width < 500 });
        browser.devtools("Emulation.setDeviceMetricsOverride", &metrics);
        browser.open(&address);
        assert_eq!(browser.run(include_str!("seen.js")), json!([]), "{width}");
    }
    assert_eq!(errors(browser), Vec::<Value>::new());
}

#[test]
fn a_copy_of_the_page_works_from_any_web_server() {
    let Some(driver) = std::env::var_os("LODESTONE_CHROMEDRIVER") else { return };
    let folder = tempfile::tempdir().unwrap();
    let of_two_and_three =
        ["--set", "actor.tasks.filter={sizes={min=2,max=3}}", "--set", "evaluator.selection.blueprints=[]"];
    train_two(folder.path(), &of_two_and_three);
    finished(lodestone(folder.path()).args(["serve", "first", "second", "--export", "copy"]));
    // A plain file server that knows nothing about this program.
    let mut python = Command::new("python3");
    let files = python.args(["-u", "-m", "http.server", "--bind", "127.0.0.1", "0"]).current_dir(folder.path());
    let mut server = Process(files.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap());
    let line = lines(server.0.stdout.take().unwrap()).next().unwrap();
    let address = &line[line.find("http://").unwrap()..line.find("/)").unwrap()];
    let browser = Browser::start(&driver, folder.path(), &format!("{address}/copy/"));
    browser.until("document.querySelector('#state').textContent === 'a copy'");
    // The copy starts with an episode and shows the numbers, but has no controls that would need the program.
    browser.until("snapshots.all.length > 0 && replay.episode && !document.querySelector('#replay-player').hidden");
    let (opened, named) = (browser.run("return replay.episode.blueprint"), browser.run("return model.about.recorded"));
    assert!(opened.as_str().is_some_and(|id| id.starts_with("3_")), "{opened} is not of the largest that were trained");
    assert!(named.as_array().is_some_and(|ids| ids.contains(&opened) && ids.len() >= 6), "{named}");
    browser.until("document.querySelector('#groups caption')?.textContent.includes('weights')");
    assert_eq!(browser.run("return document.querySelector('#draw, #stage-again, #replay-ask, footer')"), Value::Null);
    browser.element("#stage-agent input[value=expert]").click();
    browser.until("document.querySelector('#replay-note').textContent.startsWith('The expert builds ')");
    // It has what the snapshots built, too.
    let snapshot = RunPaths::new(folder.path().join("first")).snapshots().into_keys().next().unwrap();
    browser.element("#stage-agent input[value=policy]").click();
    browser.element("#snapshot").press(HOME);
    browser.until(&format!("replay.episode?.caption?.startsWith('policy after {snapshot} steps')"));
    browser.until(ARE_SIDE_BY_SIDE);
    let seen = errors(&browser);
    // Browsers request this icon from every server.
    let others: Vec<&Value> = seen.iter().filter(|entry| !entry["message"].to_string().contains("favicon")).collect();
    assert_eq!(others, Vec::<&Value>::new());
}

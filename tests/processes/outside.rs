//! Paths that are not text, printed commands, and texts that a terminal would act on.

use std::ffi::OsStr;
use std::fs;
use std::os::unix::ffi::OsStrExt;
use std::process::Command;

use blueprints::Catalog;

use crate::support::program::{lodestone, printed, printed_json, read_json, refused};

#[test]
fn paths_are_bytes_and_printed_commands_can_be_pasted() {
    let folder = tempfile::tempdir().unwrap();
    let (run, model, goal) = (&b"$HOME's run \xff"[..], &b"model \xff"[..], &b"my \xffgoal.toml"[..]);
    let [run, model, goal] = [run, model, goal].map(OsStr::from_bytes);
    let short = ["--preset", "smoke", "--steps", "1", "--no-web", "--set", "evaluator.evaluate_last=false"];
    let text = printed(lodestone(folder.path()).arg("train").args(short).arg("--run-dir").arg(run));
    assert!(folder.path().join(run).join("checkpoints").is_dir());
    let command = |start: &str| text.lines().find_map(|line| line.trim_start().strip_prefix(start)).unwrap();
    let resume = command("continue it: ").replace("--steps N", "--steps 1 --no-web --json");
    let summary = printed_json(Command::new("bash").args(["-c", &resume]).current_dir(folder.path()));
    assert_eq!(summary["run_dir"], run.to_string_lossy().as_ref());
    let meta = read_json(&folder.path().join(run).join("meta.json"));
    assert_eq!(meta["resumed_from"], run.to_string_lossy().as_ref());

    let long = "x".repeat(255);
    for out in [model, OsStr::new(&long)] {
        printed(lodestone(folder.path()).arg("export").arg("--checkpoint").arg(run).arg("--out").arg(out));
    }
    assert!(folder.path().join(model).is_file());
    let text = Catalog::builtin().get(&"2_003".parse().unwrap()).unwrap().to_toml("a test");
    fs::write(folder.path().join(goal), text.replace("\"2_003\"", "\"mine\"")).unwrap();
    let mut eval = lodestone(folder.path());
    let eval = eval.args(["eval", "--episodes", "1", "--json"]).arg("--blueprint").arg(goal).arg("--checkpoint");
    let report = printed_json(eval.arg(model));
    assert_eq!(report["blueprints"][0]["blueprint"], "mine");
}

#[test]
fn what_a_terminal_would_act_on_is_escaped() {
    let folder = tempfile::tempdir().unwrap();
    let text = Catalog::builtin().get(&"2_003".parse().unwrap()).unwrap().to_toml("a test");
    let title = text.lines().find(|line| line.starts_with("title")).unwrap();
    let name = "a\u{202e}\u{1b}[2Jb.toml";
    let title = text.replace(title, "title = \"x\\u001b[31m\\ny\\u202e\"");
    fs::write(folder.path().join(name), title).unwrap();
    let listed = printed(lodestone(folder.path()).args(["blueprints", "list", name]));
    assert!(listed.ends_with("x\\u001b[31m\\ny\\u202e\n"), "{listed}");
    let checked = printed(lodestone(folder.path()).args(["blueprints", "check", name]));
    assert!(checked.contains("a\\u202e\\u001b[2Jb.toml"), "{checked}");
    let gone = ["blueprints", "list", "gone\u{1b}[2J"];
    let gone = refused(lodestone(folder.path()).args(gone), 64, &["gone\\u001b[2J"]);
    assert!(!gone.contains('\u{1b}'), "{gone}");
    // Clap leaves escape sequences out, and nothing else.
    let unknown = refused(lodestone(folder.path()).arg("tr\u{1b}[2Jai\u{202e}n"), 2, &["'trai\\u202en'"]);
    assert!(!unknown.contains(['\u{1b}', '\u{202e}']), "{unknown}");
}

//! Paths that are not text, printed commands, and texts that a terminal would act on.

use std::ffi::OsStr;
use std::fs;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use std::process::{Command, Output};

use blueprints::Catalog;

use crate::support::program::lodestone;

/// The text of a process that succeeded.
fn printed(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// Runs a printed command in a shell.
fn pasted(folder: &Path, command: &str) -> Output {
    Command::new("bash").args(["-c", command]).current_dir(folder).output().unwrap()
}

#[test]
fn paths_are_bytes_and_printed_commands_can_be_pasted() {
    let folder = tempfile::tempdir().unwrap();
    let (run, model, goal) = (&b"$HOME's run \xff"[..], &b"model \xff"[..], &b"my \xffgoal.toml"[..]);
    let [run, model, goal] = [run, model, goal].map(OsStr::from_bytes);
    let short = ["--preset", "near-goal", "--steps", "1", "--no-web", "--set", "evaluator.evaluate_last=false"];
    let text = printed(&lodestone(folder.path()).arg("train").args(short).arg("--run-dir").arg(run).output().unwrap());
    assert!(folder.path().join(run).join("checkpoints").is_dir());
    let command = |start: &str| text.lines().find_map(|line| line.trim_start().strip_prefix(start)).unwrap();
    let resumed = pasted(folder.path(), &command("continue it: ").replace("--steps N", "--steps 1 --no-web --json"));
    let summary: serde_json::Value = serde_json::from_str(&printed(&resumed)).unwrap();
    assert_eq!(summary["run_dir"], run.to_string_lossy().as_ref());
    let meta: serde_json::Value =
        serde_json::from_slice(&fs::read(folder.path().join(run).join("meta.json")).unwrap()).unwrap();
    assert_eq!(meta["resumed_from"], run.to_string_lossy().as_ref());

    let export = |out: &OsStr| {
        lodestone(folder.path()).arg("export").arg("--checkpoint").arg(run).arg("--out").arg(out).output()
    };
    printed(&export(model).unwrap());
    assert!(folder.path().join(model).is_file());
    let long = "x".repeat(255);
    printed(&export(OsStr::new(&long)).unwrap());
    let text = Catalog::builtin().get(&"2_003".parse().unwrap()).unwrap().to_toml("a test");
    fs::write(folder.path().join(goal), text.replace("\"2_003\"", "\"mine\"")).unwrap();
    let mut eval = lodestone(folder.path());
    let eval = eval.args(["eval", "--episodes", "1", "--json"]).arg("--blueprint").arg(goal).arg("--checkpoint");
    let report: serde_json::Value = serde_json::from_str(&printed(&eval.arg(model).output().unwrap())).unwrap();
    assert_eq!(report["blueprints"][0]["blueprint"], "mine");
}

#[test]
fn what_a_terminal_would_act_on_is_escaped() {
    let folder = tempfile::tempdir().unwrap();
    let text = Catalog::builtin().get(&"2_003".parse().unwrap()).unwrap().to_toml("a test");
    let title = text.lines().find(|line| line.starts_with("title")).unwrap();
    let (name, title) = ("a\u{202e}\u{1b}[2Jb.toml", text.replace(title, "title = \"x\\u001b[31m\\ny\\u202e\""));
    fs::write(folder.path().join(name), title).unwrap();
    let ran = |args: &[&str]| lodestone(folder.path()).args(args).output().unwrap();
    let listed = printed(&ran(&["blueprints", "list", name]));
    assert!(listed.ends_with("x\\u001b[31m\\ny\\u202e\n"), "{listed}");
    let checked = printed(&ran(&["blueprints", "check", name]));
    assert!(checked.contains("a\\u202e\\u001b[2Jb.toml"), "{checked}");
    let refused = |args: &[&str]| String::from_utf8(ran(args).stderr).unwrap();
    let gone = refused(&["blueprints", "list", "gone\u{1b}[2J"]);
    assert!(gone.contains("gone\\u001b[2J") && !gone.contains('\u{1b}'), "{gone}");
    // Clap leaves escape sequences out, and nothing else.
    let unknown = refused(&["tr\u{1b}[2Jai\u{202e}n"]);
    assert!(unknown.contains("'trai\\u202en'") && !unknown.contains(['\u{1b}', '\u{202e}']), "{unknown}");
}

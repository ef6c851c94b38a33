//! `report` on handmade histories: the files that it writes, and its errors when there is nothing to show.

use std::path::Path;
use std::process::Command;

use runlog::{History, RunPaths};

use crate::support::program::{lodestone, names, printed, printed_json, refused};
use crate::support::written::{write_run, write_sweep};

fn report(folder: &Path, args: &[&str]) -> Command {
    let mut command = lodestone(folder);
    command.arg("report").args(args);
    command
}

#[test]
fn tables_are_written() {
    let folder = tempfile::tempdir().unwrap();
    write_run(&folder.path().join("run"), &["2_000", "2_001"], &[0, 500, 900, 700]);
    write_run(&folder.path().join("other"), &["2_001", "2_002"], &[10]);
    let stdout = printed(&mut report(folder.path(), &["run"]));
    // The weights evaluated at 900 steps were discarded when the run resumed from an earlier checkpoint.
    for words in [
        "run: left out 1 evaluation",
        "3 evaluations of 2 blueprints",
        "| train 2-6 | 2 | greedy | 20 | 100.0 % |",
        "serve run",
    ] {
        assert!(stdout.contains(words), "no {words:?} in {stdout}");
    }
    let plain = ["curves.csv", "groups.csv", "groups.md", "success.csv"];
    assert_eq!(names(&folder.path().join("run/report")), plain);
    let table = std::fs::read_to_string(folder.path().join("run/report/groups.md")).unwrap();
    assert!(table.contains("| train 2-6 | 2 | greedy | 20 | 100.0 % |"), "{table}");

    let summary = printed_json(&mut report(folder.path(), &["run", "--json"]));
    assert_eq!((summary["n_evaluations"].as_u64(), summary["n_env_steps"].as_u64()), (Some(3), Some(700)));
    assert_eq!(summary["groups"][0]["name"], "train 2-6");
    assert_eq!(summary["groups"][0]["success"]["n_episodes"], 20);
    assert_eq!(
        (&summary["groups"][0]["acting"], &summary["groups"][0]["stable_success"]["n_episodes"]),
        (&"greedy".into(), &20.into())
    );
    assert_eq!(summary["files"].as_array().unwrap().len(), plain.len());

    // Where only sampled actions were evaluated, the tables are of them.
    let mut evaluations = History::read(&RunPaths::new(folder.path().join("other")).history()).unwrap();
    let scores = &mut evaluations[0].blueprints;
    scores.iter_mut().for_each(|score| std::mem::swap(&mut score.greedy, &mut score.sampled));
    let sampled = RunPaths::new(folder.path().join("sampled"));
    History::open(&sampled.history()).unwrap().append(&evaluations[0]).unwrap();
    assert_eq!(printed_json(&mut report(folder.path(), &["sampled", "--json"]))["acting"], "sampled");

    let read = |file: &str| std::fs::read_to_string(folder.path().join(file)).unwrap();
    let rows = "split,n_blocks,blueprint,0,500,700\ntrain,2,2_000,1,1,1\ntrain,2,2_001,1,1,1\n";
    assert_eq!(read("run/report/success.csv"), rows);
    let curves = read("run/report/curves.csv");
    assert!(curves.starts_with("group,n_env_steps,") && curves.contains("\ntrain 2-6,500,2,20,1,"), "{curves}");

    printed(&mut report(folder.path(), &["run", "--out", "beside", "--beside", "other", "run"]));
    let table = read("beside/comparison.csv");
    assert!(table.contains("\nother,10,1,10,1,") && table.contains("\nrun,700,1,10,1,"), "{table}");
}

#[test]
fn tables_of_a_sweep_are_written() {
    let folder = tempfile::tempdir().unwrap();
    write_sweep(&folder.path().join("s"), &["0.9", "0.95"], 2);
    let stdout = printed(&mut report(folder.path(), &["s"]));
    let row = "| learner.gamma=0.95 | greedy | 2 | 100.0 (100.0–100.0) |";
    assert!(stdout.contains(row) && stdout.contains("serve s"), "{stdout}");
    assert_eq!(names(&folder.path().join("s/report")), ["curves.csv", "groups.csv", "groups.md"]);
    let read = |file: &str| std::fs::read_to_string(folder.path().join("s/report").join(file)).unwrap();
    assert!(stdout.starts_with(read("groups.md").trim_end()), "{stdout}");
    let curves = read("curves.csv");
    assert!(curves.contains("\nlearner.gamma=0.9,500,train 2-6,greedy,2,2,1,1,1,1,1,1\n"), "{curves}");
    assert_eq!(curves.lines().count(), 1 + 2 * 2, "two evaluations of both points");
    let summary = printed_json(&mut report(folder.path(), &["s", "--json"]));
    assert_eq!(summary["sweep"]["points"][1]["curve"][1]["n_env_steps"], 1000);
    assert_eq!(summary["files"].as_array().unwrap().len(), 3);
}

#[test]
fn what_cannot_be_shown_is_named_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let path = |run: &str| folder.path().join(run);
    write_run(&path("run"), &["2_000"], &[0]);
    write_run(&path("strange"), &["2_001"], &[0]);
    write_run(&path("empty"), &[], &[]);
    write_run(&path("newer"), &["2_000"], &[0]);
    // The header of an SQLite file holds the user version at byte 60, in big-endian order.
    let mut bytes = std::fs::read(RunPaths::new(path("newer")).history()).unwrap();
    bytes[60..64].copy_from_slice(&9_u32.to_be_bytes());
    std::fs::write(RunPaths::new(path("newer")).history(), bytes).unwrap();
    std::fs::create_dir(path("bare")).unwrap();
    write_sweep(&path("sweep"), &["0.9"], 1);
    write_sweep(&path("begun"), &["0.9"], 1);
    std::fs::remove_file(path("begun/point-1/seed-1.json")).unwrap();
    for (args, code, words) in [
        (&["bare"][..], 66, &["bare/eval.db", "evaluator --run-dir"][..]),
        (&["gone"], 66, &["gone does not exist"]),
        (&["newer"], 66, &["newer/eval.db", "schema version 9", "use the newer program"]),
        (&["empty"], 66, &["empty/eval.db", "no evaluation yet", "--resume"]),
        (&["run", "--acting", "sampled"], 66, &["no evaluation of sampled actions", "use --acting greedy"]),
        (&["run", "--beside", "strange"], 66, &["no blueprint", "run and the runs beside it", "evaluator.selection"]),
        (&["run", "--beside", "empty"], 66, &["empty/eval.db", "no evaluation yet"]),
        (&["run", "--beside", "bare"], 66, &["bare/eval.db", "no history"]),
        (&["begun"], 66, &["no run of begun is done yet"]),
        (&["sweep", "--acting", "sampled"], 66, &["sweep has no evaluation of sampled actions", "use --acting greedy"]),
        (&["sweep", "--beside", "run"], 2, &["--beside compares runs, and RUN is a sweep"]),
        (&["run", "--acting", "mod"], 2, &["--acting", "mod", "sampled"]),
        (&[], 2, &["<RUN>"]),
    ] {
        refused(&mut report(folder.path(), args), code, words);
        assert!(!path("run/report").exists() && !path("bare/eval.db").exists(), "{args:?} left files behind");
    }
}

//! `report` on handmade histories: the files that it writes, and its errors when there is nothing to show.

use std::path::Path;
use std::process::{Command, Output};

use blueprints::{BlueprintId, Split};
use proto::WeightsVersion;
use proto::metrics::{EvalBlueprint, EvalOutcome, METRICS_SCHEMA_VERSION};
use proto::wilson::SuccessRate;
use runlog::History;
use runlog::Pass;
use runlog::RunPaths;

fn report(folder: &Path, args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lodestone"));
    command.arg("report").args(args).current_dir(folder).env_remove("RUST_LOG").output().unwrap()
}

/// Writes one evaluation of two-block blueprints after each number of steps; all greedy episodes succeed.
fn write_run(run: &Path, ids: &[&str], steps: &[u64]) {
    let mut history = History::open(&RunPaths::new(run).history()).unwrap();
    for &n_env_steps in steps {
        let weights_version = WeightsVersion(n_env_steps);
        let score = |id: &&str| EvalBlueprint {
            schema_version: METRICS_SCHEMA_VERSION,
            weights_version,
            n_env_steps,
            blueprint: BlueprintId::try_from((*id).to_owned()).unwrap(),
            split: Split::Train,
            n_blocks: 2,
            sampled: EvalOutcome::default(),
            greedy: EvalOutcome { success: SuccessRate::new(4, 4), ..EvalOutcome::default() },
        };
        let blueprints = ids.iter().map(score).collect();
        let (ended_unix_ms, elapsed_s, seed) = (1_767_225_600_000, 2.5, 1);
        let pass = Pass { ended_unix_ms, elapsed_s, weights_version, n_env_steps, seed, blueprints, reset_free: None };
        history.append(&pass).unwrap();
    }
}

fn names(folder: &Path) -> Vec<String> {
    let files = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = files.map(|file| file.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn tables_are_written() {
    let folder = tempfile::tempdir().unwrap();
    write_run(&folder.path().join("run"), &["2_000", "2_001"], &[0, 500, 900, 700]);
    write_run(&folder.path().join("other"), &["2_001", "2_002"], &[10]);
    let output = report(folder.path(), &["run"]);
    let stdout = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    // The weights evaluated at 900 steps were discarded when the run resumed from an earlier checkpoint.
    for words in [
        "run: left out 1 evaluation",
        "3 evaluations of 2 blueprints",
        "| train 2-6 | 2 | greedy | 8 | 100.0 % |",
        "serve run",
    ] {
        assert!(stdout.contains(words), "no {words:?} in {stdout}");
    }
    let plain = ["curves.csv", "groups.csv", "groups.md", "success.csv"];
    assert_eq!(names(&folder.path().join("run/report")), plain);
    let table = std::fs::read_to_string(folder.path().join("run/report/groups.md")).unwrap();
    assert!(table.contains("| train 2-6 | 2 | greedy | 8 | 100.0 % |"), "{table}");

    let output = report(folder.path(), &["run", "--json"]);
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((summary["n_evaluations"].as_u64(), summary["n_env_steps"].as_u64()), (Some(3), Some(700)));
    assert_eq!(summary["groups"][0]["name"], "train 2-6");
    assert_eq!(summary["groups"][0]["success"]["n_episodes"], 8);
    assert_eq!(summary["files"].as_array().unwrap().len(), plain.len());

    let read = |file: &str| std::fs::read_to_string(folder.path().join(file)).unwrap();
    let rows = "split,n_blocks,blueprint,0,500,700\ntrain,2,2_000,1,1,1\ntrain,2,2_001,1,1,1\n";
    assert_eq!(read("run/report/success.csv"), rows);
    let curves = read("run/report/curves.csv");
    assert!(curves.starts_with("group,n_env_steps,") && curves.contains("\ntrain 2-6,500,2,8,1,"), "{curves}");

    let output = report(folder.path(), &["run", "--minus", "other", "--out", "new/tables"]);
    let stdout = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    // Only the blueprint that both runs evaluated, without a difference.
    assert_eq!(read("new/tables/difference.csv"), "split,n_blocks,blueprint,0\ntrain,2,2_001,0\n");
    assert!(stdout.contains("at most 10 environment steps apart"), "{stdout}");

    let output = report(folder.path(), &["run", "--out", "beside", "--beside", "other", "run"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let table = read("beside/comparison.csv");
    assert!(table.contains("\nother,10,1,4,1,") && table.contains("\nrun,700,1,4,1,"), "{table}");
}

#[test]
fn runs_with_the_same_folder_name_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    for run in ["compact/seed-1", "resnet/seed-1"] {
        write_run(&folder.path().join(run), &["2_000"], &[0, 500]);
    }
    let output = report(folder.path(), &["compact/seed-1", "--out", "out", "--beside", "resnet/seed-1"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let table = std::fs::read_to_string(folder.path().join("out/comparison.csv")).unwrap();
    assert!(table.contains("\ncompact/seed-1,0,") && table.contains("\nresnet/seed-1,500,"), "{table}");
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
    for (args, code, words) in [
        (&["bare"][..], 66, &["bare/eval.db", "evaluator --run-dir"][..]),
        (&["gone"], 66, &["gone does not exist"]),
        (&["newer"], 66, &["newer/eval.db", "schema version 9", "use the newer program"]),
        (&["empty"], 66, &["empty/eval.db", "no evaluation yet"]),
        (&["run", "--acting", "sampled"], 66, &["no evaluation of sampled actions", "use --acting greedy"]),
        (&["run", "--minus", "strange"], 66, &["run and strange", "no blueprint in common", "evaluator.selection"]),
        (&["run", "--beside", "strange"], 66, &["no blueprint", "run and the runs beside it", "evaluator.selection"]),
        (&["run", "--beside", "empty"], 66, &["empty/eval.db", "no evaluation yet"]),
        (&["run", "--minus", "bare"], 66, &["bare/eval.db", "no history"]),
        (&["run", "--acting", "mod"], 2, &["--acting", "mod", "sampled"]),
        (&[], 2, &["<RUN>"]),
    ] {
        let output = report(folder.path(), args);
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{args:?}: {stderr}");
        for word in words {
            assert!(stderr.contains(word), "{args:?} does not say {word:?}: {stderr}");
        }
        assert!(!path("run/report").exists() && !path("bare/eval.db").exists(), "{args:?} left files behind");
    }
}

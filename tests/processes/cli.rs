//! How the program responds to misuse: it names what is wrong and what would be valid, and exits with the right code.

use std::path::Path;
use std::process::{Command, Stdio};

use deploy::config::{Config, PRESETS};

use crate::support::judges::{output_of_script, python};
use crate::support::program::{finished, kill, lines, lodestone, names, printed, printed_json, refused};

/// Expects this exit code and all of `words` on stderr.
fn check_refused(args: &[&str], variables: &[(&str, &str)], file: Option<&str>, code: i32, words: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    if let Some(text) = file {
        std::fs::write(folder.path().join("my.toml"), text).unwrap();
    }
    refused(lodestone(folder.path()).args(args).envs(variables.iter().copied()), code, words);
    assert!(!folder.path().join("runs").exists(), "{args:?} left a run directory behind");
}

#[test]
fn wrong_flags_are_named_with_what_is_valid() {
    for (args, words) in [
        (&["train", "--step", "5"][..], &["--step", "--steps"][..]),
        (&["train", "--steps", "0"], &["--steps", "0 is not in 1.."]),
        (&["train", "--steps", "many"], &["--steps", "many"]),
        (&["train", "--actors", "65"], &["--actors", "65 is not in 1..=64"]),
        (&["train", "--preset", "papr"], &["papr", "paper", "quickstart"]),
        (&["train", "--device", "tpu"], &["--device", "tpu", "cpu", "gpu"]),
        (&["train", "--device", "cuda"], &["--device", "cuda", "a similar value exists: 'gpu'"]),
        (&["learner", "--device", "CUDA:0"], &["--device", "CUDA:0", "a similar value exists: 'gpu'"]),
        (&["train", "--web", "page"], &["--web", "page", "ADDRESS:PORT"]),
        (&["completions", "cmd"], &["cmd", "bash", "zsh", "fish"]),
        (&["eval"], &["--checkpoint", "--pretrained"]),
        (&["eval", "--checkpoint", "x", "--pretrained"], &["--checkpoint", "--pretrained", "cannot be used with"]),
        (&["play", "--checkpoint", "x", "--pretrained"], &["--checkpoint", "--pretrained", "cannot be used with"]),
        (&["train", "--web", "127.0.0.1:0", "--no-web"], &["--web", "--no-web", "cannot be used with"]),
        (&["record", "--out", "x"], &["--blueprint", "--split"]),
        (&["record", "--split", "train"], &["--out"]),
        (&["record", "--out", "x", "--expert", "--sampled"], &["--sampled", "cannot be used with"]),
        (&["serve"], &["<RUN>"]),
        (&["export", "--checkpoint", "x"], &["--out"]),
        (&["eval", "--checkpoint", "x", "--split", "trian"], &["--split", "trian", "train"]),
        (&["eval", "--checkpoint", "x", "--episodes", "0"], &["--episodes", "0 is not in 1..=10000"]),
        (&["eval", "--expert", "--pretrained"], &["--expert", "cannot be used with"]),
        (&["eval", "--expert", "--blueprint", "2_000", "--split", "train"], &["--split", "cannot be used with"]),
        (&["router"], &["--listen"]),
        (&["render", "x.trajectory"], &["--out"]),
        (&["render", "x", "--out", "videos", "--width", "3"], &["--width", "480..=1920"]),
        (&["train", "--steps", "-3"], &["--steps", "-3 is not in 1.."]),
        (&["train", "--seed", "-1"], &["--seed", "-1 is not in 0.."]),
        (&["tarin"], &["tarin", "train"]),
    ] {
        check_refused(args, &[], None, 2, words);
    }
}

#[test]
fn wrong_configurations_are_named_with_what_is_valid() {
    let with_file = &["train", "--config", "my.toml"][..];
    for (args, file, words) in [
        (with_file, None, &["my.toml", "cannot read"][..]),
        (with_file, Some("[actor]\nn_worlds = \"three\""), &["my.toml:2", "three"]),
        (with_file, Some("seed = = 1"), &["my.toml:1"]),
        (with_file, Some("[actor]\nn_worlds = 0"), &["actor.n_worlds = 0: expected 1..=1024"]),
        (with_file, Some("[learner]\ngamma = 1.5"), &["learner", "gamma", "1.5"]),
        (
            with_file,
            Some("[environment]\nn_grippers = 1"),
            &["environment.n_grippers = 1: expected 2", "policy.features.n_grippers"],
        ),
        (&["train", "--run", "My Run"], None, &["bus.run", "My Run", "a-z"]),
        (&["actor"], None, &["bus.connect = []", "router"]),
        (&["train", "--config", "/dev/zero"], None, &["/dev/zero: it has more than 1048576 bytes"]),
        (&["blueprints", "check", "my.toml"], Some("id = 3"), &["1 of 1 blueprints failed a check"]),
        (&["blueprints", "check", "/dev/zero"], None, &["/dev/zero: it has more than 1048576 bytes"]),
        (&["render", "my.toml", "--out", "videos"], Some("seed = 1"), &["my.toml", "is not a recorded trajectory"]),
        (&["render", "my.toml", "--out", "videos"], Some(""), &["my.toml", "is empty"]),
        (&["render", "my.toml", "--out", "videos"], Some("\u{8}\u{1}\u{12}\u{6}exp"), &["my.toml", "cut off"]),
        (&["blueprints", "list", "gone"], None, &["gone", "cannot read"]),
        (&["eval", "--expert", "--blueprint", "6-005"], None, &["`6-005`", "did you mean `6_005`"]),
        (&["eval", "--expert", "--blueprint", "12_00"], None, &["did you mean `12_000`"]),
        (&["eval", "--expert", "--set", "environment.n_griper=1"], None, &["did you mean `n_grippers`"]),
        (&["eval", "--expert", "--set", "environment.n_grippers=3"], None, &["environment.n_grippers = 3"]),
        (&["eval", "--expert", "--set", "policy.mask=none"], None, &["policy.mask"]),
    ] {
        check_refused(args, &[], file, 64, words);
    }
}

#[test]
fn a_wrong_variable_is_named() {
    let variables = [("LODESTONE_LEARNER__GAMA", "0.9")];
    check_refused(&["train"], &variables, None, 64, &["LODESTONE_LEARNER__GAMA", "did you mean `gamma`"]);
    // One underscore instead of two.
    let variables = [("LODESTONE_LEARNER_GAMMA", "0.5")];
    let words = ["LODESTONE_LEARNER_GAMMA", "did you mean `LODESTONE_LEARNER__GAMMA`"];
    check_refused(&["blueprints", "list"], &variables, None, 64, &words);
    let steps = [("LODESTONE_STEPS", "abc")];
    check_refused(&["train"], &steps, None, 2, &["'abc' for '--steps <N>'", "variable LODESTONE_STEPS"]);
}

#[test]
fn whatever_is_missing_is_named_with_one_code() {
    check_refused(&["eval", "--checkpoint", "/dev/zero"], &[], None, 66, &["/dev/zero: it has more than"]);
    for args in [
        &["eval", "--checkpoint", "gone"][..],
        &["play", "--checkpoint", "gone"],
        &["record", "--checkpoint", "gone", "--split", "test", "--out", "played"],
        &["export", "--checkpoint", "gone", "--out", "policy.safetensors"],
        &["train", "--resume", "gone"],
        &["learner", "--resume", "gone", "--connect", "tcp/127.0.0.1:1"],
        &["train", "--init-from", "gone"],
        &["serve", "gone"],
        &["report", "gone"],
        &["render", "gone", "--out", "videos"],
    ] {
        check_refused(args, &[], None, 66, &["error: gone does not exist"]);
    }
}

#[test]
fn an_endpoint_that_makes_no_sense_is_named() {
    for (role, endpoint) in [("router", "nonsense"), ("router", "udp/127.0.0.1:7447"), ("router", "tcp/localhost")] {
        check_refused(&[role, "--listen", endpoint], &[], None, 64, &[endpoint, "tcp/HOST:PORT"]);
    }
    check_refused(&["actor", "--connect", "localhost"], &[], None, 64, &["`localhost`", "tcp/HOST:PORT"]);
}

#[cfg(not(feature = "gpu"))]
#[test]
fn a_gpu_that_is_not_built_in_is_refused_before_anything_starts() {
    check_refused(&["train", "--device", "gpu"], &[], None, 64, &["no GPU backend", "--features gpu"]);
}

#[test]
fn layers_are_put_over_each_other_in_order() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("my.toml"), "seed = 1\n[actor]\nn_worlds = 11\nsegment_len = 11").unwrap();
    let variables = [("LODESTONE_ACTOR__N_WORLDS", "12"), ("LODESTONE_SEED", "12")];
    let flags = ["--set", "actor.n_threads=13", "--seed", "13", "--listen", "localhost:7447", "--print-config"];
    let all = printed(lodestone(folder.path()).args(["train", "--config", "my.toml"]).args(flags).envs(variables));
    for line in
        ["seed = 13", "segment_len = 11", "n_worlds = 12", "n_threads = 13", "listen = [\"tcp/localhost:7447\"]"]
    {
        assert!(all.lines().any(|printed| printed == line), "no {line:?} in {all}");
    }
}

#[test]
fn a_printed_configuration_can_be_short_or_explained() {
    let folder = tempfile::tempdir().unwrap();
    let printed = |args: &[&str]| printed(lodestone(folder.path()).args(["train", "--print-config"]).args(args));
    let print = |args: &[&str]| printed(&[&["--preset", "laptop", "--set", "learner.gamma=0.9"][..], args].concat());
    let changed = print(&["--changed"]);
    assert_eq!(changed.trim(), "base = \"laptop\"\n[learner]\ngamma = 0.9");
    let explained = print(&["--changed", "--explain"]);
    assert!(explained.contains("\n# Discount γ per step (0 to 1; default 0.99).\ngamma = 0.9\n"), "{explained}");
    std::fs::write(folder.path().join("my.toml"), print(&["--explain"])).unwrap();
    assert_eq!(printed(&["--config", "my.toml"]), print(&[]));
}

#[test]
fn editors_get_a_schema_that_takes_every_preset_and_no_misspelled_key() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let schema = printed(lodestone(folder.path()).args(["train", "--print-config", "--schema"]));
    std::fs::write(path("schema.json"), schema).unwrap();
    let wrong = [
        ("[learner]\ngama = 0.9", "'gama' was unexpected"),
        ("[learner]\ngamma = 1.5", "1.5 is greater than the maximum of 1"),
        ("device = \"tpu\"", "'tpu' is not one of ['cpu', 'gpu']"),
        ("[learner.curriculum]\nkind = \"uniform\"\ngate = 0.5", "is not valid under any of the given schemas"),
    ];
    let mut files: Vec<String> = Vec::new();
    for (number, (text, _)) in wrong.iter().enumerate() {
        files.push(path(&format!("{number}.toml")));
        std::fs::write(&files[number], text).unwrap();
    }
    for preset in PRESETS {
        files.extend([path(preset.name), path(&format!("{}-whole", preset.name))]);
        std::fs::write(path(preset.name), preset.text).unwrap();
        let whole = Config::parse(preset.text, preset.name).unwrap();
        std::fs::write(&files[files.len() - 1], whole.to_toml()).unwrap();
    }
    let Some(python) = python() else { return };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/processes/schema.py");
    let schema = path("schema.json");
    let args: Vec<&str> = [&schema].into_iter().chain(&files).map(String::as_str).collect();
    let problems = output_of_script(&python, &script, &args);
    for (number, file) in files.iter().enumerate() {
        match wrong.get(number) {
            Some((text, words)) => {
                assert!(problems[file][0].as_str().unwrap().contains(words), "{text}: {}", problems[file])
            }
            None => assert_eq!(problems[file], serde_json::json!([]), "{file}"),
        }
    }
}

#[test]
fn shells_know_the_commands() {
    let folder = tempfile::tempdir().unwrap();
    for shell in ["bash", "zsh", "fish"] {
        let text = printed(lodestone(folder.path()).args(["completions", shell]));
        for words in ["evaluator", "learner.optimizer.learning_rate=", "16_002", "smoke"] {
            assert!(text.contains(words), "{shell}: no {words} in {text}");
        }
        std::fs::write(folder.path().join(shell), text).unwrap();
    }
    // In the shells themselves, where they are installed, as if these words had been typed before Tab.
    for (words, expected) in [
        ("train --set learner.gam", "learner.gamma="),
        ("play 16_00", "16_000 16_001 16_002"),
        ("report --acting s", "sampled"),
        ("eval --split v", "validation"),
        ("train --blueprint 2_00", "2_000 2_001"),
        ("train --preset la", "laptop"),
        ("serve ru", ""),
    ] {
        let typed: Vec<&str> = words.split(' ').collect();
        let (last, before) = (typed[typed.len() - 1], typed[typed.len() - 2]);
        let script = format!(
            "source ./bash; COMP_WORDS=(lodestone {words}); COMP_CWORD={}; _lodestone lodestone {last} {before} 2>&-; \
             echo \"${{COMPREPLY[*]}}\"",
            typed.len()
        );
        let offers = |shell: &str, script: &str| {
            let Ok(ended) = Command::new(shell).args(["-c", script]).current_dir(folder.path()).output() else {
                return;
            };
            let offered = String::from_utf8(ended.stdout).unwrap();
            assert!(
                offered.starts_with(expected) && offered.trim().is_empty() == expected.is_empty(),
                "{shell}: {words}: {offered}"
            );
        };
        offers("bash", &script);
        offers(
            "fish",
            &format!("source ./fish; complete -C 'lodestone {words}' | string split -f 1 \\t | string join ' '"),
        );
    }
}

#[test]
fn an_interrupted_evaluation_says_what_it_has_found() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = lodestone(folder.path());
    command.args(["eval", "--expert", "--blueprint", "16_000", "--episodes", "10000", "--json"]);
    let mut evaluation = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = lines(evaluation.stderr.take().unwrap());
    // Wait until some episodes have ended.
    lines.find(|line| line.contains("of 10000 episodes")).unwrap();
    kill("-INT", evaluation.id());
    let output = evaluation.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130));
    assert!(lines.any(|line| line.contains("error: interrupted after")));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let n_episodes = report["blueprints"][0]["greedy"]["success"]["n_episodes"].as_u64().unwrap();
    assert!((1..10_000).contains(&n_episodes), "{report}");
    assert_eq!(report["summary"]["is_complete"], false);
}

#[test]
fn the_catalog_is_listed_and_checked() {
    let folder = tempfile::tempdir().unwrap();
    let rows = printed_json(lodestone(folder.path()).args(["blueprints", "list", "--json"]));
    let is_two_block = |row: &&serde_json::Value| row["n_blocks"] == 2 && row["split"] == "train";
    assert_eq!(rows.as_array().unwrap().iter().filter(is_two_block).count(), 14);
    finished(lodestone(folder.path()).args(["blueprints", "check"]));
}

/// Writes `corner.toml`, a blueprint of two blocks.
fn write_corner(folder: &Path) {
    let blocks = "blocks = [{ type = \"3x1x1\", at = [0, 0, 0] }, { type = \"1x1x1\", at = [2, 0, 1] }]";
    std::fs::write(folder.join("corner.toml"), blocks).unwrap();
}

#[test]
fn a_drawing_of_types_and_places_is_completed() {
    let folder = tempfile::tempdir().unwrap();
    write_corner(folder.path());
    let check = ["blueprints", "check", "corner.toml", "--write", "whole.toml"];
    let stdout = printed(lodestone(folder.path()).args(check));
    for words in [
        "corner.toml: block \"block-1\" is turned \"+x +y\": it can fill [3, 1, 1] cells only",
        "corner.toml: blocks \"block-1\" and \"block-2\" are connected by 1 magnet pair",
        "1 of 1 blueprints passed all checks",
    ] {
        assert!(stdout.contains(words), "no {words:?} in {stdout}");
    }
    let whole = std::fs::read_to_string(folder.path().join("whole.toml")).unwrap();
    assert!(whole.starts_with("id = \"corner\"") && whole.contains("\"-z(0,0,0) +z(2,0,0)\""), "{whole}");
    // No file is replaced.
    refused(lodestone(folder.path()).args(check), 64, &[]);
    let rows = printed_json(lodestone(folder.path()).args(["blueprints", "list", "corner.toml", "--json"]));
    assert_eq!((&rows[0]["id"], &rows[0]["n_connections"]), (&"corner".into(), &1.into()));
}

#[test]
fn blueprints_are_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["blueprints", "show", "2_000", "6_005", "2_000", "--size", "320", "--out", "new/pictures"];
    finished(lodestone(folder.path()).args(args));
    assert_eq!(names(&folder.path().join("new/pictures")), ["2_000.png", "6_005.png", "sheet.png"]);
    // A PNG begins with its signature, 8 bytes of chunk header, and the width.
    let card = std::fs::read(folder.path().join("new/pictures/6_005.png")).unwrap();
    assert_eq!((&card[..8], &card[16..20]), (&b"\x89PNG\r\n\x1a\n"[..], &320_u32.to_be_bytes()[..]));
    write_corner(folder.path());
    let own = ["blueprints", "show", "corner.toml", "--out", "own"];
    finished(lodestone(folder.path()).args(own));
    assert_eq!(names(&folder.path().join("own")), ["corner.png", "sheet.png"]);
}

#[test]
fn what_cannot_be_drawn_is_named_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    for (args, code, words) in [
        (&["2_000", "6-005"][..], 64, &["`6-005`", "did you mean `6_005`"][..]),
        (&["gone.toml"], 64, &["gone", "cannot read"]),
        (&["2_000", "--split", "train"], 2, &["--split", "cannot be used with"]),
        (&["--size", "319"], 2, &["--size", "319 is not in 320..=4000"]),
    ] {
        let show = ["blueprints", "show", "--out", "pictures"];
        refused(lodestone(folder.path()).args(show).args(args), code, words);
        assert!(!folder.path().join("pictures").exists(), "{args:?} left files behind");
    }
}

#[test]
fn the_expert_is_evaluated_like_a_policy() {
    let folder = tempfile::tempdir().unwrap();
    let eval = |args: &[&str]| {
        let mut command = lodestone(folder.path());
        command.args(["eval", "--expert", "--episodes", "2"]).args(args);
        command
    };
    let json = |args: &[&str]| printed_json(eval(args).arg("--json"));
    let good = json(&["--blueprint", "2_000", "--blueprint", "6_005"]);
    assert_eq!(good["blueprints"].as_array().unwrap().len(), 2);
    assert_eq!(good["summary"]["all"]["greedy"]["success"]["n_episodes"], 4);
    let one_gripper = json(&["--blueprint", "2_000", "--set", "environment.n_grippers=1"]);
    assert_ne!(one_gripper["summary"]["all"]["greedy"]["success"]["n_successes"], 0);
    let short = printed(&mut eval(&["--blueprint", "16_000", "--set", "environment.episode_steps=5", "--endings"]));
    assert!(short.starts_with("blueprint "), "{short}");
    // Time runs out in all of them.
    let ending = short.lines().find(|line| line.starts_with("greedy      16      2")).unwrap_or_default();
    assert!(ending.contains(" 100.0 "), "{short}");
}

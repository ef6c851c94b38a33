//! Every preset parses, is valid, survives a round trip, and is embedded in the binary; values out of range are named.

use std::collections::BTreeSet;

use deploy::config::{Config, DEFAULTS, Override, PRESETS, check_variables, merge};
use proto::Valid;

use crate::repository::{files, read, root, shown};

#[test]
fn presets_and_defaults_are_valid_and_round_trip() {
    let presets = PRESETS.iter().map(|preset| (preset.name, Config::parse(preset.text, preset.name).unwrap()));
    for (name, config) in presets.chain([("the defaults", Config::default())]) {
        config.clone().checked().unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(Config::parse(&config.to_toml(), "written again").unwrap(), config, "{name}");
    }
}

#[test]
fn the_binary_embeds_every_preset() {
    let in_folder: BTreeSet<String> = files(&root().join("deploy/config"), &["toml"])
        .iter()
        .map(|path| path.file_stem().unwrap().to_string_lossy().into_owned())
        .collect();
    let embedded: BTreeSet<String> = PRESETS.iter().map(|preset| preset.name.to_owned()).collect();
    assert_eq!(embedded, in_folder);
}

#[test]
fn a_value_out_of_range_is_named_with_its_range() {
    for (set, error) in [
        ("actor.n_threads=0", "actor.n_threads = 0: expected 1..=64"),
        ("actor.n_worlds=2000", "actor.n_worlds = 2000: expected 1..=1024"),
        ("actor.segment_len=0", "actor.segment_len = 0: expected 1..=1000"),
        ("actor.backlog_limit=0", "actor.backlog_limit = 0: expected 1..=100000"),
        ("bus.run=My Run", r#"bus.run = "My Run": expected 1 to 64 characters of a-z, 0-9 and -"#),
        (
            "bus.mode=client",
            "bus.connect = []: expected a router's endpoint for a client, such as tcp/HOST:7447 with --connect",
        ),
        ("bus.weights_mb_per_s=0", "bus.weights_mb_per_s = 0: expected 1..=1000000"),
        ("environment.n_grippers=3", "environment.n_grippers = 3: expected 1..=2"),
        ("environment.max_speed_mps=nan", "environment.max_speed_mps = NaN: expected 0.01..=10"),
        ("environment.magnets.snap_gap_m=0.2", "environment.magnets.snap_gap_m = 0.2: expected 0.001..=0.045"),
        (
            "environment.randomization.snap_gap_m=[0.03, 0.01]",
            "environment.randomization.snap_gap_m = [0.03, 0.01]: expected the lower end first",
        ),
        ("environment.physics.friction=-1.0", "environment.physics.friction = -1: expected 0..=2"),
        ("evaluator.every={ steps = 0 }", "evaluator.every.steps = 0: expected at least 1"),
        ("evaluator.every={ minutes = nan }", "evaluator.every.minutes = NaN: expected 0..=10000"),
        (
            r#"evaluator.episodes.acting=["greedy", "greedy"]"#,
            r#"evaluator.episodes.acting = ["greedy", "greedy"]: expected "greedy", "sampled" or both"#,
        ),
        ("evaluator.reset_free={ n_goals = 0 }", "evaluator.reset_free.n_goals = 0: expected 1..=1000"),
        (
            r#"evaluator.videos.groups=["train 2-6", "train 2-6"]"#,
            r#"evaluator.videos.groups = ["train 2-6", "train 2-6"]: expected names of groups, none twice"#,
        ),
        ("learner.gamma=1.5", "learner.gamma = 1.5: expected 0..=1"),
        ("learner.gae_lambda=nan", "learner.gae_lambda = NaN: expected 0..=1"),
        ("learner.n_epochs=0", "learner.n_epochs = 0: expected 1..=32"),
        ("learner.minibatch_size=9000", "learner.minibatch_size = 9000: expected 1..=batch_size"),
        ("learner.loss.clip_range=0.0", "learner.loss.clip_range = 0: expected above 0 and at most 1"),
        ("learner.mailbox.capacity_steps=1", "learner.mailbox.capacity_steps = 1: expected at least batch_size"),
        ("learner.checkpoints.keep=0", "learner.checkpoints.keep = 0: expected at least 1"),
        ("learner.optimizer.learning_rate=inf", "learner.optimizer.learning_rate = inf: expected above 0 and finite"),
        ("policy.features.n_grippers=3", "policy.features.n_grippers = 3: expected 1..=2"),
        ("policy.network.width=0", "policy.network.width = 0: expected 1..=1024"),
        ("policy.network.init_std=0.0", "policy.network.init_std = 0: expected above 0.000001 and at most 10"),
        (
            r#"policy.network.encoder={ kind = "resnet", hidden = 8192, n_blocks = 32 }"#,
            "the number of parameters of policy.network = 4303880192: expected at most 25165824: make it smaller",
        ),
    ] {
        let set = Override::parse(set).unwrap();
        let config = merge("", "the defaults", &DEFAULTS, &[set]).unwrap();
        assert_eq!(Valid::new(config).unwrap_err().to_string(), error);
    }
}

#[test]
fn every_variable_of_scripts_and_manifests_exists() {
    let mut paths = files(root(), &["sh", "sbatch", "yaml", "yml", "py", "example"]);
    paths.extend([".ci/run", "deploy/slurm/lodestone-slurm", "deploy/Dockerfile"].map(|path| root().join(path)));
    let program = deploy::cli::program();
    let mut n_names = 0;
    for path in paths {
        let text = read(&path);
        for rest in text.split("LODESTONE_").skip(1) {
            let end = rest.find(|c: char| !(c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_'));
            let name = format!("LODESTONE_{}", &rest[..end.unwrap_or(rest.len())]);
            if name.ends_with('_') {
                continue;
            }
            n_names += 1;
            let known = check_variables([name.as_str()], &program);
            assert!(known.is_ok(), "{}: {}", shown(&path), known.unwrap_err());
        }
    }
    assert!(n_names > 100, "{n_names} names were found");
}

//! Complete checkpoints resume exactly; incomplete ones are refused.

use std::fs;
use std::path::{Path, PathBuf};

use policy::ModelError;
use proto::Weights;
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use safetensors::SafeTensors;
use serde_json::{Value, json};

use super::learning::{bandit, learn, small_setup};
use crate::adam::LearningRate;
use crate::checkpoint::{self, Checkpoint, CheckpointError, files};
use crate::config::{AdaptiveRate, LrSchedule};
use crate::state::LearnerState;
use crate::{Learner, LearnerError, LearnerSetup, Model, read_model};

/// Runs `n` updates with trajectories determined by `seed` and the learner's weights.
fn train(setup: &LearnerSetup, learner: &mut Learner, n: u64) {
    for _ in 0..n {
        let mut rng = ChaCha8Rng::seed_from_u64(learner.version().0);
        // 40 more steps than an update consumes, so that some are always waiting.
        let trajectories = bandit(setup, &learner.weights(), 296, &mut rng);
        learn(learner, trajectories);
    }
}

/// Saves a learner after `n` updates. Returns the folder of its checkpoints first, and the checkpoint last.
fn saved(n: u64) -> (tempfile::TempDir, LearnerSetup, Learner, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let setup = small_setup(4);
    let mut learner = Learner::new(setup.clone()).unwrap();
    train(&setup, &mut learner, n);
    let path = learner.checkpoint().write(dir.path()).unwrap();
    (dir, setup, learner, path)
}

#[test]
fn resumed_learner_continues_bit_for_bit() {
    let (dir, setup, mut learner, path) = saved(2);
    let found = Checkpoint::read_latest(dir.path()).unwrap();
    assert_eq!((&found.path, found.passed_over.len()), (&path, 0));
    assert_eq!(found.checkpoint, learner.checkpoint());
    assert_eq!(found.checkpoint.weights(), learner.weights());
    let mut resumed = Learner::resume(setup.clone(), found.checkpoint).unwrap();
    train(&setup, &mut learner, 2);
    train(&setup, &mut resumed, 2);
    assert_eq!(resumed.checkpoint(), learner.checkpoint());
    assert_eq!(resumed.weights(), learner.weights());
}

#[test]
fn resumed_learner_takes_another_fixed_rate() {
    let dir = tempfile::tempdir().unwrap();
    let setup = small_setup(4).at_rate(3e-4);
    let path = Learner::new(setup.clone()).unwrap().checkpoint().write(dir.path()).unwrap();
    let mut resumed = Learner::resume(setup.clone().at_rate(1e-4), Checkpoint::read(&path).unwrap()).unwrap();
    let trajectories = bandit(&setup, &resumed.weights(), 256, &mut ChaCha8Rng::seed_from_u64(5));
    assert_eq!(learn(&mut resumed, trajectories).metrics.ppo.learning_rate, f64::from(1e-4_f32));
}

#[test]
fn resumed_learner_takes_another_adaptive_rate_or_other_bounds() {
    let (_dir, setup, _, path) = saved(2);
    let adapted = Checkpoint::read(&path).unwrap().state.learning_rate.0;
    assert_ne!(adapted, setup.config.optimizer.learning_rate);
    let resumed = |learning_rate, max, checkpoint: Checkpoint| {
        let setup = setup.clone().with(|c| {
            c.optimizer.learning_rate = learning_rate;
            c.optimizer.lr_schedule = LrSchedule::Adaptive(AdaptiveRate { max, ..Default::default() });
        });
        let checkpoint = Learner::resume(setup, checkpoint).unwrap().checkpoint();
        (checkpoint.state.learning_rate.0, checkpoint)
    };
    let saved = || Checkpoint::read(&path).unwrap();
    let same = setup.config.optimizer.learning_rate;
    assert_eq!(resumed(same, 1e-3, saved()).0, adapted, "what was adapted goes on");
    let (rate, changed) = resumed(2e-5, 1e-3, saved());
    assert_eq!(rate, 2e-5, "another rate takes effect");
    let state = LearnerState { learning_rate: LearningRate(5e-5), ..changed.state.clone() };
    assert_eq!(resumed(2e-5, 1e-3, Checkpoint { state, ..changed }).0, 5e-5, "but only once");
    assert_eq!(resumed(same, 4e-5, saved()).0, 4e-5, "and so does another bound");
}

#[test]
fn a_checkpoint_with_which_no_policy_can_act_is_not_resumed() {
    let (_dir, setup, learner, _) = saved(1);
    let mut checkpoint = learner.checkpoint();
    checkpoint.parameters.fill(1e30);
    let error = Learner::resume(setup, checkpoint).unwrap_err();
    assert!(matches!(error, LearnerError::Weights(_)), "{error}");
}

#[test]
fn truncated_files_are_named() {
    let (_dir, _, _, path) = saved(1);
    for name in ["parameters.safetensors", "adam.safetensors", "mailbox.bin", "model.json", "state.json"] {
        let file = path.join(name);
        let whole = fs::read(&file).unwrap();
        for length in [0, 1, 7, 8, whole.len() / 3, whole.len() / 2, whole.len() - 9, whole.len() - 1] {
            fs::write(&file, &whole[..length]).unwrap();
            let error = Checkpoint::read(&path).unwrap_err();
            let is_named = matches!(&error, CheckpointError::File(path, ModelError::Damaged(_)) if path == &file);
            assert!(is_named, "{name} {length}: {error}");
            assert!(error.to_string().contains(name));
        }
        let mut flipped = whole.clone();
        flipped[whole.len() / 2] ^= 1;
        fs::write(&file, &flipped).unwrap();
        assert!(Checkpoint::read(&path).is_err() || name == "state.json", "{name}");
        fs::remove_file(&file).unwrap();
        assert!(Checkpoint::read(&path).unwrap_err().to_string().contains(name));
        fs::write(&file, &whole).unwrap();
    }
    Checkpoint::read(&path).unwrap();
}

#[test]
fn newest_valid_checkpoint_is_found() {
    let (dir, setup, mut learner, older) = saved(1);
    train(&setup, &mut learner, 1);
    let newer = learner.checkpoint().write(dir.path()).unwrap();
    fs::write(newer.join("adam.safetensors"), b"short").unwrap();
    let found = Checkpoint::read_latest(dir.path()).unwrap();
    assert_eq!(found.path, older);
    assert!(found.passed_over[0].to_string().contains("adam.safetensors"));
    fs::remove_file(older.join("state.json")).unwrap();
    assert!(Checkpoint::read_latest(dir.path()).unwrap_err().to_string().contains("adam.safetensors"));
}

#[test]
fn oldest_and_unfinished_checkpoints_are_removed() {
    let (dir, setup, mut learner, _) = saved(1);
    for _ in 0..3 {
        train(&setup, &mut learner, 1);
        learner.checkpoint().write(dir.path()).unwrap();
    }
    // Saving again replaces the checkpoint of the same step.
    learner.checkpoint().write(dir.path()).unwrap();
    fs::create_dir(dir.path().join(".new-99")).unwrap();
    checkpoint::prune(dir.path(), learner.n_env_steps(), 2).unwrap();
    assert_eq!(names(dir.path()), ["step-1024", "step-768"]);
}

#[test]
fn a_damaged_checkpoint_of_later_steps_does_not_displace_the_newest() {
    let (dir, setup, mut learner, _) = saved(1);
    train(&setup, &mut learner, 2);
    let damaged = learner.checkpoint().write(dir.path()).unwrap();
    fs::write(damaged.join("adam.safetensors"), b"short").unwrap();
    let found = Checkpoint::read_latest(dir.path()).unwrap();
    let mut resumed = Learner::resume(setup.clone(), found.checkpoint).unwrap();
    train(&setup, &mut resumed, 1);
    let path = resumed.checkpoint().write(dir.path()).unwrap();
    checkpoint::prune(dir.path(), resumed.n_env_steps(), 1).unwrap();
    assert_eq!(Checkpoint::read_latest(dir.path()).unwrap().path, path);
}

fn names(dir: &Path) -> Vec<String> {
    let names = fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<_> = names.collect();
    names.sort();
    names
}

#[test]
fn failed_write_leaves_nothing_and_blocks_nothing() {
    let (dir, setup, mut learner, older) = saved(1);
    // First with a checkpoint that would replace the older one, then with one of another step.
    for n_updates in [0, 1] {
        train(&setup, &mut learner, n_updates);
        let checkpoint = learner.checkpoint();
        for n_whole in 0..5 {
            let mut n_written = 0;
            // Simulates a full disk: the first files fit, and half of the next one.
            let mut full = |folder: &Path, name: &str, bytes: &[u8]| {
                n_written += 1;
                if n_written <= n_whole {
                    return files::write(folder, name, bytes);
                }
                fs::write(folder.join(name), &bytes[..bytes.len() / 2]).unwrap();
                let error = std::io::ErrorKind::StorageFull.into();
                Err(CheckpointError::Io("writing", folder.join(name), error))
            };
            let error = checkpoint.write_with(dir.path(), &mut full).unwrap_err();
            assert!(error.to_string().contains("no storage space"), "{error}");
            assert_eq!(names(dir.path()), ["step-256"]);
            assert_eq!(Checkpoint::read_latest(dir.path()).unwrap().path, older);
        }
    }
    learner.checkpoint().write(dir.path()).unwrap();
    assert_eq!(names(dir.path()), ["step-256", "step-512"]);
}

#[test]
fn leftovers_of_a_killed_process_are_cleaned_up() {
    let (dir, _, _, path) = saved(1);
    let whole = Checkpoint::read(&path).unwrap();
    // Killed during a write, and between the two renames of a replacement.
    fs::create_dir(dir.path().join(".new-512")).unwrap();
    fs::write(dir.path().join(".new-512").join("adam.safetensors"), b"short").unwrap();
    fs::rename(&path, dir.path().join(".old-step-256")).unwrap();
    checkpoint::clean(dir.path()).unwrap();
    assert_eq!(names(dir.path()), ["step-256"]);
    assert_eq!(Checkpoint::read(&path).unwrap(), whole);
    // Killed before it removed the replaced checkpoint.
    fs::create_dir(dir.path().join(".old-step-256")).unwrap();
    checkpoint::clean(dir.path()).unwrap();
    assert_eq!(names(dir.path()), ["step-256"]);
    checkpoint::clean(&dir.path().join("nothing")).unwrap();
}

#[test]
fn checkpoint_of_another_network_is_refused() {
    let (dir, setup, learner, _) = saved(1);
    let other = setup.with_policy(|c| c.network.width = 32);
    let error = Learner::resume(other, learner.checkpoint()).unwrap_err();
    assert!(matches!(error, LearnerError::Checkpoint(CheckpointError::Mismatch(_))), "{error}");
    let empty = dir.path().join("nothing");
    assert!(matches!(Checkpoint::read_latest(&empty), Err(CheckpointError::Absent(_))));
}

#[test]
fn model_round_trips_and_a_damaged_file_is_refused() {
    let checkpoint = Learner::new(small_setup(4)).unwrap().checkpoint();
    let model = Model::from(&checkpoint);
    let bytes = model.to_bytes().unwrap();
    assert_eq!(bytes, model.to_bytes().unwrap(), "the same bytes every time");
    assert_eq!(Model::from_bytes(&bytes).unwrap(), model);
    policy::Policy::new(&model.policy).load(&model.weights).unwrap();
    // From what is published, with a verdict.
    let published = Model::new(&checkpoint.model, &checkpoint.weights());
    assert_eq!(published, model);
    let mut evaluated = published;
    evaluated.verdict = Some(serde_json::json!({ "goals": "train" }));
    assert_eq!(Model::from_bytes(&evaluated.to_bytes().unwrap()).unwrap(), evaluated);
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("model.safetensors");
    for broken in [&bytes[..bytes.len() - 1], &bytes[..100], b"", b"no such format"] {
        fs::write(&path, broken).unwrap();
        let error = read_model(&path).unwrap_err().to_string();
        assert!(error.contains("model.safetensors is damaged: it is no safetensors file: "), "{error}");
    }
    // A file with only tensors, as in a checkpoint.
    let folder = checkpoint.write(dir.path()).unwrap();
    let alone = fs::read(folder.join("parameters.safetensors")).unwrap();
    let error = Model::from_bytes(&alone).unwrap_err().to_string();
    assert!(error.contains("no entry `lodestone`"), "{error}");
}

#[test]
fn policies_that_belong_together_have_a_mean() {
    let first = Model::from(&Learner::new(small_setup(4)).unwrap().checkpoint());
    let mut second = first.clone();
    second.weights.parameters.iter_mut().for_each(|x| *x += 0.5);
    second.weights.normalization.value_mean = 4.0;
    second.weights.n_env_steps += 1000;
    let mean = Model::mean(&[first.clone(), second.clone()]).unwrap();
    let off =
        |found: &[f32], by: f32| found.iter().zip(&first.weights.parameters).any(|(a, b)| (a - b - by).abs() > 1e-6);
    assert!(!off(&mean.weights.parameters, 0.25));
    let parameters = first.weights.parameters.clone();
    assert_eq!(Model { weights: Weights { parameters, ..mean.weights }, ..mean }, first, "the rest is the first one's");
    assert_eq!(Model::mean(std::slice::from_ref(&first)).unwrap(), first);
    second.weights.normalization.feature_mean[1] = vec![0.1];
    assert_eq!(Model::mean(&[first.clone(), first.clone(), second]).unwrap_err(), 2);
    let other = small_setup(4).with_policy(|c| c.network.width = 32);
    let wider = Model::from(&Learner::new(other).unwrap().checkpoint());
    assert_eq!(Model::mean(&[first, wider]).unwrap_err(), 1);
}

/// Swaps the names of two tensors of one shape in a table.
fn swap_two(table: &mut [Value]) {
    let pairs = (0..table.len()).flat_map(|b| (0..b).map(move |a| (a, b)));
    let (a, b) = pairs.into_iter().find(|&(a, b)| table[a]["shape"] == table[b]["shape"]).unwrap();
    table.swap(a, b);
}

/// Changes the metadata of a model file.
fn with_header(bytes: &[u8], change: impl FnOnce(&mut Value)) -> Vec<u8> {
    let (_, metadata) = SafeTensors::read_metadata(bytes).unwrap();
    let mut header: Value = serde_json::from_str(&metadata.metadata().as_ref().unwrap()["lodestone"]).unwrap();
    change(&mut header);
    let tensors = SafeTensors::deserialize(bytes).unwrap();
    safetensors::serialize(tensors.iter(), Some([("lodestone".to_owned(), header.to_string())].into())).unwrap()
}

#[test]
fn swapped_tensors_are_refused_by_the_digest() {
    let (_dir, _, learner, folder) = saved(1);
    let model = Model::from(&learner.checkpoint());
    let bytes = model.to_bytes().unwrap();
    assert_eq!(Model::from_bytes(&with_header(&bytes, |_| {})).unwrap(), model);
    let swapped = with_header(&bytes, |header| swap_two(header["table"].as_array_mut().unwrap()));
    let error = Model::from_bytes(&swapped).unwrap_err().to_string();
    assert!(error.contains("the digest of its tensors is "), "{error}");
    let without = with_header(&bytes, |header| drop(header.as_object_mut().unwrap().remove("digest")));
    let error = Model::from_bytes(&without).unwrap_err().to_string();
    assert!(error.contains("missing field `digest`"), "{error}");

    let file = folder.join("state.json");
    let mut state: Value = serde_json::from_slice(&fs::read(&file).unwrap()).unwrap();
    swap_two(state["table"].as_array_mut().unwrap());
    fs::write(&file, state.to_string()).unwrap();
    let error = Checkpoint::read(&folder).unwrap_err().to_string();
    assert!(error.contains("state.json is damaged: the digest of its tensors is "), "{error}");
}

#[test]
fn a_policy_of_a_kind_that_is_not_known_is_refused_by_the_setting() {
    let bytes = Model::from(&Learner::new(small_setup(4)).unwrap().checkpoint()).to_bytes().unwrap();
    let encoder: fn(&mut Value) = |header| header["policy"]["network"]["encoder"]["kind"] = json!("spline");
    for (change, setting) in [
        (encoder, "spline"),
        (|header| header["policy"]["head_of_tomorrow"] = json!({ "kind": "spline" }), "head_of_tomorrow"),
        (|header| header["policy"]["mask"] = json!("guess"), "guess"),
        (|header| header["policy"]["network"]["move_head"] = json!("splines"), "splines"),
    ] {
        let error = Model::from_bytes(&with_header(&bytes, change)).unwrap_err();
        assert!(matches!(error, ModelError::UnknownPolicy(_)), "{error}");
        assert!(error.to_string().contains(setting), "{error}");
    }
    let newer = with_header(&bytes, |header| header["format_version"] = 5.into());
    let error = Model::from_bytes(&newer).unwrap_err().to_string();
    assert!(error.contains("has format version 5, and this program reads version 4"), "{error}");
}

#[test]
fn a_state_with_numbers_that_no_run_has_is_refused_by_file_and_key() {
    let (_dir, _, _, folder) = saved(1);
    let file = folder.join("state.json");
    let whole = fs::read_to_string(&file).unwrap();
    let state: Value = serde_json::from_str(&whole).unwrap();
    let cases = [
        ("/state/version", json!(u64::MAX), "state.version = 18446744073709551615: expected at most"),
        ("/state/learning_rate", json!(-1.0), "state.learning_rate = -1: expected at least 0"),
        ("/state/values/std", json!(-1.0), "state.values.std = -1: expected above 0 and finite"),
        ("/state/values/mean_square", json!(-1.0), "state.values.mean_square = -1"),
        (
            "/state/normalization/value_std",
            json!(0.0),
            "state.normalization.value_std = 0: expected above 0 and finite",
        ),
        ("/state/normalization/value_mean", json!(1e300), "`\"value_mean\": 1e+300"),
        ("/state/normalization/feature_std/0/0", json!(-1.0), "state.normalization.feature_std[0] = -1"),
        ("/state/normalization/feature_mean/1", json!([]), "state.normalization.feature_mean[1] = 0 numbers"),
        ("/state/curriculum/tasks/2_000/probability", json!(-5.0), "state.curriculum.tasks.2_000.probability = -5"),
        ("/state/curriculum/tasks/2_000/probability", json!(0.5), "state.curriculum.tasks = a sum of 0.5"),
        ("/state/curriculum/tasks/2_000/success_rate", json!(1.5), "state.curriculum.tasks.2_000.success_rate = 1.5"),
        ("/state/features/groups/0/count", json!(-1.0), "state.features.groups[0].count = -1"),
        ("/state/features/groups/0/squares/0", json!(-1.0), "state.features.groups[0].squares = -1"),
        ("/state/features/groups/1/mean", json!([0.0]), "state.features.groups[1] = 1 means"),
    ];
    for (pointer, value, message) in cases {
        let mut state = state.clone();
        *state.pointer_mut(pointer).unwrap() = value;
        fs::write(&file, serde_json::to_string_pretty(&state).unwrap()).unwrap();
        let error = Checkpoint::read(&folder).unwrap_err().to_string();
        assert!(error.contains("state.json is damaged: ") && error.contains(message), "{pointer}: {error}");
    }
    for odd in ["NaN", "null", "1e300", "\"x\""] {
        let rate = whole.lines().find(|line| line.contains("\"learning_rate\"")).unwrap();
        fs::write(&file, whole.replace(rate, &format!("    \"learning_rate\": {odd},"))).unwrap();
        let error = Checkpoint::read(&folder).unwrap_err().to_string();
        assert!(error.contains("state.json is damaged") && error.contains("learning_rate"), "{error}");
    }
}

//! The shipped policy performs as it did when it was measured.

use blueprints::{Catalog, Split};
use evaluator::config::{EpisodeConfig, Starts};
use evaluator::{EvalSetup, Follower, N_WORLDS, Performer, evaluate};
use learner::read_model;
use proto::{ActionMode, Valid};

use crate::repository::{read, root};

/// Steps to success in one greedy episode of each validation blueprint, from mixed starts with seed 1, or `None` for a
/// failure; measured on a CPU with AVX-512. Other CPUs sum in a different order, and a few episodes end differently.
const SAMPLE: [(&str, Option<u16>); 24] = [
    ("validation_7_000", Some(30)),
    ("validation_7_001", Some(26)),
    ("validation_8_000", Some(34)),
    ("validation_8_001", Some(46)),
    ("validation_9_000", Some(39)),
    ("validation_9_001", Some(32)),
    ("validation_10_000", Some(43)),
    ("validation_10_001", Some(41)),
    ("validation_11_000", Some(44)),
    ("validation_11_001", Some(48)),
    ("validation_12_000", Some(50)),
    ("validation_12_001", Some(59)),
    ("validation_12_002", Some(59)),
    ("validation_13_000", Some(55)),
    ("validation_13_001", Some(66)),
    ("validation_13_002", Some(81)),
    ("validation_14_000", Some(59)),
    ("validation_14_001", Some(66)),
    ("validation_14_002", Some(64)),
    ("validation_15_000", Some(65)),
    ("validation_15_001", Some(62)),
    ("validation_15_002", Some(72)),
    ("validation_16_000", Some(65)),
    ("validation_16_001", None),
];

#[test]
fn the_shipped_policy_repeats_a_sample_of_its_episodes() {
    let model = read_model(&root().join("deploy/pretrained/model.safetensors")).unwrap();
    let catalog = Catalog::builtin();
    let setup = EvalSetup {
        catalog,
        environment: Valid::default(),
        episodes: EpisodeConfig {
            n_episodes: 1,
            starts: Starts::Mixed,
            acting: vec![ActionMode::Greedy],
            n_threads: 2,
            ..EpisodeConfig::default()
        },
        reset_free: None,
        n_worlds: N_WORLDS,
        seed: 1,
    };
    let mut goals = catalog.of_split(Split::Validation).to_vec();
    goals.retain(|goal| goal.n_blocks() >= 7);
    let performer = Performer::Policy(&model.policy, &model.weights);
    let report = evaluate(&setup, performer, &goals, &Follower::default()).unwrap();
    let found: Vec<(&str, Option<u16>)> = report
        .blueprints
        .iter()
        .map(|score| (score.blueprint.as_str(), score.greedy.mean_steps_to_success.map(|steps| steps as u16)))
        .collect();
    if is_same_arithmetic() {
        assert_eq!(found, SAMPLE);
    } else {
        let n_same = found.iter().zip(SAMPLE).filter(|(a, b)| (a.0, a.1.is_some()) == (b.0, b.1.is_some())).count();
        assert!(n_same + 3 >= SAMPLE.len(), "{found:?}");
    }
}

#[test]
fn what_the_page_says_of_its_success_is_about_the_shipped_policy() {
    let folder = root().join("deploy/pretrained");
    let model = read_model(&folder.join("model.safetensors")).unwrap();
    let success: serde_json::Value = serde_json::from_str(&read(&folder.join("success.json"))).unwrap();
    assert_eq!(success["weights_version"], model.weights.version.0);
    let sizes: Vec<String> = (2..=16).map(|n| n.to_string()).collect();
    let has_all =
        |acting: &str| sizes.iter().all(|size| success[acting][size][0].as_u64() <= success[acting][size][1].as_u64());
    assert!(has_all("greedy") && has_all("sampled") && success["greedy"]["16"][1].is_u64(), "{success}");
}

/// Whether this CPU sums in the order in which the sample was measured.
fn is_same_arithmetic() -> bool {
    #[cfg(target_arch = "x86_64")]
    return std::arch::is_x86_feature_detected!("avx512f");
    #[cfg(not(target_arch = "x86_64"))]
    false
}

//! Numbers by which processes and files of different builds recognize each other. They change only if their meaning
//! does.

use burn::tensor::Device;
use deploy::config::{ABLATIONS, Config, PRESETS, Preset, merge};
use learner::read_model;
use policy::Engine;
use proto::codec::MAX_PARAMETERS;

use crate::repository::root;

/// The hash of each preset's network, which weights on the bus carry.
const NETWORK_HASHES: [(&str, u64); 4] = [
    ("quickstart", 0x5d69_b2da_362c_296d),
    ("laptop", 0xcd55_5783_5718_686c),
    ("smoke", 0x2470_05f8_8989_b13d),
    ("paper", 0xb361_4ee6_7daf_7b79),
];

fn network_hash(preset: &str) -> u64 {
    let preset = PRESETS.iter().find(|known| known.name == preset).unwrap();
    Config::parse(preset.text, preset.name).unwrap().policy.hash()
}

#[test]
fn the_networks_of_the_presets_keep_their_hashes() {
    let found: Vec<(&str, u64)> = PRESETS.iter().map(|preset| (preset.name, network_hash(preset.name))).collect();
    assert_eq!(found, NETWORK_HASHES);
}

#[test]
fn the_shipped_policy_is_read_and_is_one_of_the_laptop_preset() {
    let model = read_model(&root().join("deploy/pretrained/model.safetensors")).unwrap();
    assert_eq!((model.weights.version.0, model.weights.n_env_steps), (731, 3_000_014));
    assert_eq!(model.weights.network_hash, network_hash("laptop"));
}

#[test]
fn the_networks_of_all_ablations_fit_onto_the_bus() {
    for ablation in ABLATIONS {
        for base in ["laptop", "paper"] {
            let over = ablation.overrides().unwrap();
            let config = merge("", ablation.name, Preset::find(base).unwrap(), &over).unwrap();
            let n_parameters = Engine::new(&config.policy, 0, &Device::flex(), false).parameters().len();
            assert!(n_parameters <= MAX_PARAMETERS, "{}: {n_parameters}", ablation.name);
        }
    }
}

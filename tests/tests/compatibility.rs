//! Numbers by which processes and files of different builds recognize each other. They change only if their meaning
//! does.

use std::path::Path;

use burn::tensor::Device;
use deploy::config::{Base, Config, PRESETS, Preset, merge};
use learner::Model;
use policy::Engine;
use proto::codec::MAX_PARAMETERS;

/// The hash of each preset's network, which weights on the bus carry.
const NETWORK_HASHES: [(&str, u64); 18] = [
    ("quickstart", 0x9686_a0e2_b319_3676),
    ("laptop", 0xcb93_5c00_bb99_a5e6),
    ("fine-tune", 0xcb93_5c00_bb99_a5e6),
    ("compact", 0xcb93_5c00_bb99_a5e6),
    ("two-blocks", 0xfe94_2fa2_bb58_14c9),
    ("reverse-curriculum", 0x74ab_9863_a343_a90a),
    ("near-goal", 0x27ac_c63f_8183_123f),
    ("imitation-only", 0xb8d9_685b_cbd2_41ce),
    ("ppo-only", 0x1827_7478_dfd5_26b5),
    ("imitation-and-ppo", 0xb8d9_685b_cbd2_41ce),
    ("paper", 0x95e4_ab88_5514_1596),
    ("no-attention", 0x9a88_430e_9a9a_db51),
    ("resnet", 0x8d93_d718_1ea5_aff9),
    ("single-gripper", 0x8004_f408_2dc1_5c48),
    ("no-curriculum", 0x95e4_ab88_5514_1596),
    ("no-blueprint-resets", 0x95e4_ab88_5514_1596),
    ("transition-delay", 0x95e4_ab88_5514_1596),
    ("single-blueprint", 0x95e4_ab88_5514_1596),
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
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy/pretrained/model.safetensors");
    let model = Model::from_bytes(&std::fs::read(&path).unwrap(), &path).unwrap();
    assert_eq!((model.weights.version.0, model.weights.n_env_steps), (439, 3_602_734));
    assert_eq!(model.weights.network_hash, network_hash("laptop"));
}

#[test]
fn the_networks_of_all_ablations_fit_onto_the_bus() {
    for preset in Preset::ablations() {
        let over = preset.overrides().unwrap();
        let config = merge("base = \"laptop\"", preset.name, Base::Defaults, &over).unwrap();
        let n_parameters = Engine::new(&config.policy, 0, &Device::flex(), false).parameters().len();
        assert!(n_parameters <= MAX_PARAMETERS, "{}: {n_parameters}", preset.name);
    }
}

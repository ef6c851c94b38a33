//! Numbers by which processes and files of different builds recognize each other. They change only with a meaning.

use deploy::config::{Config, PRESETS};

/// The hash of the network of each preset, which weights on the bus carry.
const NETWORK_HASHES: [(&str, u64); 0] = [];

#[test]
fn the_networks_of_the_presets_keep_their_hashes() {
    let hash = |text: &str| Config::parse(text, "a preset").unwrap().policy.hash();
    let found: Vec<(&str, u64)> = PRESETS.iter().map(|preset| (preset.name, hash(preset.text))).collect();
    assert_eq!(found, NETWORK_HASHES);
}

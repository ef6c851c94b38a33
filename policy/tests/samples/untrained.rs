//! A small untrained policy for the tests of other crates.

use policy::{DeviceKind, EncoderConfig, GatConfig, Network, NetworkConfig, PolicyConfig, parameters};
use proto::{Normalization, Valid, Weights, WeightsVersion};

/// Returns the configuration of a network small enough for tests.
pub(crate) fn small_policy() -> Valid<PolicyConfig> {
    let encoder =
        EncoderConfig::Gat(GatConfig { n_layers: 1, n_heads: 1, head_dim: 4, mlp_hidden: 8, ..Default::default() });
    let network = NetworkConfig { encoder, width: 8, value_hidden: vec![8], ..Default::default() };
    Valid::new(PolicyConfig { network, ..Default::default() }).unwrap()
}

/// Returns untrained weights of that network, whose only task is `2_000`.
pub(crate) fn weights() -> Weights {
    let config = small_policy();
    let network = Network::init(&config.network, &config.sizes(), 1, &DeviceKind::Cpu.open().unwrap());
    Weights {
        version: WeightsVersion(2),
        n_env_steps: 77,
        network_hash: config.hash(),
        settings: Default::default(),
        parameters: parameters::flatten(&network),
        normalization: Normalization::default(),
        task_probabilities: [("2_000".parse().unwrap(), 1.0)].into(),
    }
}

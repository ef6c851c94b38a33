//! What the newest weights attend to in an episode that somebody looks at.

use parking_lot::Mutex;
use std::sync::Arc;

use policy::{Policy, PolicyConfig};
use proto::Weights;
use serde::Serialize;
use tokio::sync::watch;

use render::video::{Episode, EpisodeAttention};

/// Computes attention with the weights that are the newest when it is asked.
#[derive(Debug)]
pub(super) struct Onlooker {
    config: PolicyConfig,
    weights: watch::Receiver<Option<Arc<Weights>>>,
    /// With the weights that it was asked for last.
    policy: Mutex<Option<Policy>>,
}

/// Attention through an episode as it is sent.
#[derive(Debug, Serialize)]
pub(super) struct AttentionView {
    /// Of the weights that attend, whoever acted.
    weights_version: u64,
    /// What attends: `gripper 1`, …, and `layer 1, head 1`, ….
    sources: Vec<String>,
    /// By source and scene, what each of the 16 blocks gets, percent: of a gripper's choice, or of what the goal's blocks gather.
    percent: Vec<Vec<Vec<u8>>>,
}

impl Onlooker {
    /// For weights of this configuration, as they come.
    pub(super) fn new(config: PolicyConfig, weights: watch::Receiver<Option<Arc<Weights>>>) -> Self {
        Self { config, weights, policy: Mutex::default() }
    }

    /// `None` before the first weights, and for a network without attention. Takes some ten milliseconds.
    pub(super) fn look(&self, episode: &Episode) -> Option<AttentionView> {
        let weights = self.weights.borrow().clone()?;
        let mut kept = self.policy.lock();
        if kept.as_ref().and_then(Policy::version) != Some(weights.version) {
            let mut policy = Policy::new(&self.config).ok()?;
            policy.load(&weights).ok()?;
            *kept = Some(policy);
        }
        let attention = EpisodeAttention::new(kept.as_ref()?, episode).ok()?;
        let percent = |share: f32| (share * 100.0).round().clamp(0.0, 100.0) as u8;
        let of_source =
            |source| (0..attention.n_scenes()).map(|n| attention.received(source, n).map(percent).to_vec()).collect();
        let sources: Vec<_> = attention.sources().collect();
        Some(AttentionView {
            weights_version: weights.version.0,
            percent: sources.iter().map(|&source| of_source(source)).collect(),
            sources: sources.iter().map(ToString::to_string).collect(),
        })
    }
}

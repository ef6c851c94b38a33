//! The attention of the newest weights over a replayed episode.

use parking_lot::Mutex;
use std::sync::Arc;

use policy::{Policy, PolicyConfig};
use proto::{Valid, Weights};
use serde::Serialize;
use tokio::sync::watch;

use render::video::{Episode, EpisodeAttention};

/// Computes attention with the newest weights at the time of the request.
#[derive(Debug)]
pub(super) struct Observer {
    config: Valid<PolicyConfig>,
    weights: watch::Receiver<Option<Arc<Weights>>>,
    /// The policy with the most recently used weights.
    policy: Mutex<Option<Policy>>,
}

/// Attention over an episode, as sent to the browser.
#[derive(Debug, Serialize)]
pub(super) struct AttentionView {
    /// Version of the weights that attend; other weights or the expert may have acted.
    weights_version: u64,
    /// Names of the attention sources: `gripper 1`, …, and `layer 1, head 1`, ….
    sources: Vec<String>,
    /// Attention on each of the 16 blocks in percent, by source and scene: that of a gripper, or the mean over the
    /// goal's blocks.
    percent: Vec<Vec<Vec<u8>>>,
    /// The block that each block attends to most and the percent, by source and scene; empty for a gripper. The last
    /// one is by the mean over the heads of the last layer.
    most: Vec<Vec<Vec<(usize, u8)>>>,
}

impl Observer {
    /// Creates an observer for a stream of weights of this configuration.
    pub(super) fn new(config: Valid<PolicyConfig>, weights: watch::Receiver<Option<Arc<Weights>>>) -> Self {
        Self { config, weights, policy: Mutex::default() }
    }

    /// Returns the attention over `episode`; `None` before the first weights arrive or for a network without attention.
    /// Takes around ten milliseconds.
    pub(super) fn look(&self, episode: &Episode) -> Option<AttentionView> {
        let weights = self.weights.borrow().clone()?;
        let mut kept = self.policy.lock();
        if kept.as_ref().and_then(Policy::version) != Some(weights.version) {
            let mut policy = Policy::new(&self.config);
            policy.load(&weights).ok()?;
            *kept = Some(policy);
        }
        let attention = EpisodeAttention::new(kept.as_ref()?, episode).ok()?;
        let percent = |share: f32| (share * 100.0).round().clamp(0.0, 100.0) as u8;
        let of_source =
            |source| (0..attention.n_scenes()).map(|n| attention.received(source, n).map(percent).to_vec()).collect();
        let most = |source| {
            let all = (0..attention.n_scenes()).filter_map(|n| attention.most(source, n));
            all.map(|of| of.map(|(block, share)| (block.get(), percent(share))).to_vec()).collect()
        };
        let sources: Vec<_> = attention.sources().collect();
        Some(AttentionView {
            weights_version: weights.version.0,
            percent: sources.iter().map(|&source| of_source(source)).collect(),
            most: sources.iter().copied().map(Some).chain([None]).map(most).collect(),
            sources: sources.iter().map(ToString::to_string).collect(),
        })
    }
}

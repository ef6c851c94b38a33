//! The imitation part of an update, which learns from the expert's labels.

use policy::normalization::normalize;
use policy::{FeatureBatch, FeatureConfig};
use proto::Normalization;
use proto::metrics::ImitationMetrics;
use rand_chacha::ChaCha8Rng;

use super::passes::{ImitationBatch, ImitationSums};
use super::workers::Workers;
use crate::config::ImitationConfig;
use crate::replay::Replay;

/// The labeled scenes and their settings.
#[derive(Clone, Copy)]
pub(crate) struct ImitationSource<'a> {
    /// Settings of imitation.
    pub(crate) config: &'a ImitationConfig,
    /// Labeled scenes.
    pub(crate) replay: &'a Replay,
    /// Configuration of the features.
    pub(crate) features: &'a FeatureConfig,
    /// Normalization of the features.
    pub(crate) normalization: &'a Normalization,
}

/// The imitation part of one update.
pub(super) struct ImitationUpdate<'a> {
    imitation_source: ImitationSource<'a>,
    weight: f32,
    scale_weight: f32,
    n_left: usize,
    n_steps: u64,
    sums: ImitationSums,
}

impl<'a> ImitationUpdate<'a> {
    /// Creates the update; `None` without labeled scenes or with a weight of 0.
    pub(super) fn new(imitation_source: ImitationSource<'a>, n_env_steps: u64) -> Option<Self> {
        let weight = imitation_source.config.weight.at(n_env_steps);
        let scale_weight = imitation_source.config.scale_weight.at(n_env_steps);
        let n_left = imitation_source.config.steps_per_update.at(n_env_steps).round() as usize;
        let is_active = weight > 0.0 && imitation_source.replay.n_steps() > 0;
        is_active.then(|| Self {
            imitation_source,
            weight,
            scale_weight,
            n_left,
            n_steps: 0,
            sums: ImitationSums::default(),
        })
    }

    /// Returns the number of imitation gradient steps left in the update.
    pub(super) fn n_left(&self) -> usize {
        self.n_left
    }

    /// Adds the weighted imitation gradient of a random minibatch to `gradient`.
    pub(super) fn add_gradient(
        &mut self,
        workers: &mut Workers,
        forward_size: usize,
        rng: &mut ChaCha8Rng,
        gradient: &mut [f32],
    ) {
        let ImitationSource { config, replay, features, normalization } = self.imitation_source;
        let mut features = FeatureBatch::new(features);
        let labels = replay.draw(config.minibatch_size, rng, &mut features);
        normalize(&mut features, normalization);
        for pass in workers.imitate(&ImitationBatch { features, labels }, forward_size, config, self.scale_weight) {
            gradient.iter_mut().zip(&pass.gradient).for_each(|(sum, g)| *sum += self.weight * g);
            workers.reuse(pass.gradient);
            self.sums += pass.sums;
        }
        self.n_left = self.n_left.saturating_sub(1);
        self.n_steps += 1;
    }

    /// Returns the metrics, as means over the scenes.
    pub(super) fn metrics(&self) -> ImitationMetrics {
        let ImitationSums { blocks, moves, n_hits, n_scenes } = self.sums;
        let n = n_scenes.max(1) as f64;
        ImitationMetrics {
            weight: f64::from(self.weight),
            block_loss: blocks / n,
            move_loss: moves / n,
            block_accuracy: n_hits as f64 / n,
            n_gradient_steps: self.n_steps,
            n_replay: self.imitation_source.replay.n_steps() as u64,
        }
    }
}

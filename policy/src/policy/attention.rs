//! Reads out the network's attention in a scene, which normal forward passes do not keep.

use blueprints::{BlockIdx, N_BLOCKS};
use proto::Observation;

use super::Policy;
use crate::FeatureBatch;
use crate::distribution::{mask_logits, probabilities};
use crate::normalization::normalize;

/// Attention weights and block choices in one scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Attention {
    n_heads: usize,
    /// `[layers, receivers, heads, senders]`.
    weights: Vec<f32>,
    /// `[grippers, blocks]`.
    choices: Vec<f32>,
}

impl Attention {
    /// Returns the number of graph encoder layers with attention; 0 if the encoder has none.
    pub fn n_layers(&self) -> usize {
        self.weights.len() / (N_BLOCKS * N_BLOCKS * self.n_heads.max(1))
    }

    /// Returns the number of heads per layer.
    pub fn n_heads(&self) -> usize {
        self.n_heads
    }

    /// Returns the number of grippers.
    pub fn n_grippers(&self) -> usize {
        self.choices.len() / N_BLOCKS
    }

    /// Returns the weight with which `receiver` attends to each block in a head, 0 to 1; the 16 weights sum to 1, and
    /// that of `receiver` itself is 0.
    ///
    /// # Panics
    /// If there is no such layer or head.
    pub fn row(&self, layer: usize, head: usize, receiver: BlockIdx) -> &[f32] {
        assert!(head < self.n_heads, "head {head} of {}", self.n_heads);
        let at = ((layer * N_BLOCKS + receiver.get()) * self.n_heads + head) * N_BLOCKS;
        &self.weights[at..at + N_BLOCKS]
    }

    /// Returns the probability with which a gripper chooses each block, after masking; the 16 probabilities sum to 1.
    ///
    /// # Panics
    /// If the network has no such gripper.
    pub fn choice(&self, gripper: usize) -> &[f32] {
        &self.choices[gripper * N_BLOCKS..(gripper + 1) * N_BLOCKS]
    }
}

impl Policy {
    /// Returns the attention in every observed scene, in order.
    pub fn attention(&self, observations: &[Observation<'_>]) -> Vec<Attention> {
        if observations.is_empty() {
            return Vec::new();
        }
        let mut batch = FeatureBatch::of_policy(&self.config);
        batch.fill(observations);
        normalize(&mut batch, &self.normalization);
        let (layers, mut logits) = self.engine.attention(&batch);
        let n_heads = layers.first().map_or(0, |weights| weights.len() / (batch.n * N_BLOCKS * N_BLOCKS));
        let per_layer = N_BLOCKS * n_heads * N_BLOCKS;
        let per_scene = logits.len() / batch.n;
        let scenes = logits.chunks_exact_mut(per_scene).enumerate();
        scenes
            .map(|(row, logits)| {
                if let Some(allowed) = self.config.choosable(&batch, row) {
                    mask_logits(logits, &allowed);
                }
                let of_scene = |layer: &Vec<f32>| layer[row * per_layer..(row + 1) * per_layer].to_vec();
                Attention {
                    n_heads,
                    weights: layers.iter().flat_map(of_scene).collect(),
                    choices: logits.chunks_exact(N_BLOCKS).flat_map(probabilities).collect(),
                }
            })
            .collect()
    }
}

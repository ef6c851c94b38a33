//! What the network looks at in a scene: read out beside a forward pass, which keeps nothing of it otherwise.

use blueprints::{BlockIdx, N_BLOCKS};
use proto::Observation;

use super::Policy;
use crate::FeatureBatch;
use crate::distribution::{mask_logits, probabilities};
use crate::normalization::normalize;

/// Who attends to whom in one scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Attention {
    n_heads: usize,
    /// `[layers, receivers, heads, senders]`.
    weights: Vec<f32>,
    /// `[grippers, blocks]`.
    choices: Vec<f32>,
}

impl Attention {
    /// Number of layers of the graph encoder that attend; 0 for an encoder that weighs all blocks alike.
    pub fn n_layers(&self) -> usize {
        self.weights.len() / (N_BLOCKS * N_BLOCKS * self.n_heads.max(1))
    }

    /// Number of heads of each layer.
    pub fn n_heads(&self) -> usize {
        self.n_heads
    }

    /// Number of grippers.
    pub fn n_grippers(&self) -> usize {
        self.choices.len() / N_BLOCKS
    }

    /// How much of what `receiver` gathers in a head comes from each block, 0 to 1; the 16 sum to 1. A block gathers
    /// nothing from itself unless the configuration has self-edges.
    ///
    /// # Panics
    /// When there is no such layer or head.
    pub fn row(&self, layer: usize, head: usize, receiver: BlockIdx) -> &[f32] {
        assert!(head < self.n_heads, "head {head} of {}", self.n_heads);
        let at = ((layer * N_BLOCKS + receiver.get()) * self.n_heads + head) * N_BLOCKS;
        &self.weights[at..at + N_BLOCKS]
    }

    /// Probability with which a gripper chooses each block, the mask applied; the 16 sum to 1.
    ///
    /// # Panics
    /// When the network has no such gripper.
    pub fn choice(&self, gripper: usize) -> &[f32] {
        &self.choices[gripper * N_BLOCKS..(gripper + 1) * N_BLOCKS]
    }
}

impl Policy {
    /// What the network attends to in every observed scene, in their order.
    pub fn attention(&self, observations: &[Observation<'_>]) -> Vec<Attention> {
        if observations.is_empty() {
            return Vec::new();
        }
        let mut batch = FeatureBatch::new(&self.config.features);
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

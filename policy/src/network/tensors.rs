//! A batch of features on a device.

use burn::tensor::{Device, Tensor, TensorData};

use crate::batch::FeatureBatch;
use crate::config::{EncoderConfig, NetworkConfig};
use crate::features::N_EDGES;

/// Number of blocks.
const N: usize = blueprints::N_BLOCKS;

/// How edges are laid out on the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EdgeLayout {
    /// `[B, 256, ed]`, receiver-major, zeros for self-edges: the layout that the graph encoder multiplies.
    Dense,
    /// `[B, 240, ed]` in the order of [`FeatureBatch`].
    Listed,
}

/// Network input for B scenes.
#[derive(Clone, Debug)]
pub struct BatchTensors {
    /// `[B, 16, nd]`
    pub nodes: Tensor<3>,
    /// `[B, 256, ed]` or `[B, 240, ed]`; see [`EdgeLayout`].
    pub edges: Tensor<3>,
    /// `[B, gd]`, gripper-major, each gripper's part ending with the one-hot of the block it held.
    pub globals: Tensor<2>,
}

impl EdgeLayout {
    /// Returns the layout for a network with this configuration.
    pub fn of(config: &NetworkConfig) -> Self {
        match config.encoder {
            EncoderConfig::Gat(_) => Self::Dense,
            EncoderConfig::Resnet(_) => Self::Listed,
        }
    }
}

impl BatchTensors {
    /// Copies a batch to a device.
    pub fn new(batch: &FeatureBatch, layout: EdgeLayout, device: &Device) -> Self {
        let b = batch.n;
        let edges = match layout {
            EdgeLayout::Listed => tensor(batch.edges.clone(), [b, N_EDGES, batch.sizes.edge], device),
            EdgeLayout::Dense => {
                tensor(dense_edges(&batch.edges, b, batch.sizes.edge), [b, N * N, batch.sizes.edge], device)
            }
        };
        Self {
            nodes: tensor(batch.nodes.clone(), [b, N, batch.sizes.node], device),
            edges,
            globals: Tensor::from_data(TensorData::new(batch.globals.clone(), [b, batch.sizes.global]), device),
        }
    }
}

fn tensor(values: Vec<f32>, shape: [usize; 3], device: &Device) -> Tensor<3> {
    Tensor::from_data(TensorData::new(values, shape), device)
}

/// Returns the index of edge `sender → receiver` in the sender-major list; `None` for a self-edge, which it lacks.
pub(crate) fn listed_index(sender: usize, receiver: usize) -> Option<usize> {
    (sender != receiver).then(|| sender * (N - 1) + receiver - usize::from(receiver > sender))
}

/// Converts sender-major lists of edges to receiver-major 16×16, with zeros for self-edges.
///
/// # Shapes
/// `[b, 240, ed]` → `[b, 256, ed]`
pub fn dense_edges(listed: &[f32], b: usize, ed: usize) -> Vec<f32> {
    let mut dense = vec![0.0; b * N * N * ed];
    for (from, to) in listed.chunks_exact(N_EDGES * ed).zip(dense.chunks_exact_mut(N * N * ed)) {
        for receiver in 0..N {
            for sender in 0..N {
                if let Some(edge) = listed_index(sender, receiver) {
                    let at = (receiver * N + sender) * ed;
                    to[at..at + ed].copy_from_slice(&from[edge * ed..(edge + 1) * ed]);
                }
            }
        }
    }
    dense
}

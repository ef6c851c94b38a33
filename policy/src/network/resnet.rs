//! The "non-graph" baseline encoder (paper, appendix "ResNet Baseline Details") on the flattened features.

use blueprints::N_BLOCKS as N;
use burn::module::Module;
use burn::nn::{LayerNorm, Linear};
use burn::tensor::{Tensor, activation};

use super::BatchTensors;
use super::layers::Builder;
use crate::config::ResnetConfig;
use crate::features::{FeatureSizes, N_EDGES};
use crate::parameters::Initializer;

/// The flat encoder's parameters.
///
/// The paper does not say how the output feeds the heads; `to_nodes` and `to_global` replace the graph encoder's
/// outputs.
#[derive(Module, Debug)]
pub(super) struct ResnetEncoder {
    input: Linear,
    blocks: Vec<ResidualBlock>,
    to_nodes: Linear,
    to_global: Linear,
}

#[derive(Module, Debug)]
struct ResidualBlock {
    fc0: Linear,
    fc1: Linear,
    ln: LayerNorm,
}

impl ResnetEncoder {
    pub(super) fn build(builder: &mut Builder<'_>, config: &ResnetConfig, width: usize, sizes: &FeatureSizes) -> Self {
        let init = Initializer::HaikuLinear;
        let hidden = config.hidden;
        let n_in = N * sizes.node + N_EDGES * sizes.edge + sizes.global;
        let input = builder.linear("resnet.in", [n_in, hidden], init);
        let residual = Initializer::UniformFanOut(0.333);
        let blocks = (0..config.n_blocks)
            .map(|k| ResidualBlock {
                fc0: builder.linear(&format!("resnet.block{k}.fc0"), [hidden, hidden], residual),
                fc1: builder.linear(&format!("resnet.block{k}.fc1"), [hidden, hidden], residual),
                ln: builder.layer_norm(&format!("resnet.block{k}.ln"), hidden),
            })
            .collect();
        let to_nodes = builder.linear("resnet.to_nodes", [hidden, N * width], init);
        let to_global = builder.linear("resnet.to_global", [hidden, width], init);
        Self { input, blocks, to_nodes, to_global }
    }

    /// Encodes a batch.
    ///
    /// # Shapes
    /// Input as in [`BatchTensors`]; output nodes `[B·16, width]` and globals `[B, width]`.
    pub(super) fn forward(&self, batch: &BatchTensors) -> (Tensor<2>, Tensor<2>) {
        let b = batch.globals.dims()[0];
        let flat = Tensor::cat(
            vec![batch.nodes.clone().flatten::<2>(1, 2), batch.edges.clone().flatten(1, 2), batch.globals.clone()],
            1,
        );
        let mut x = self.input.forward(flat);
        for block in &self.blocks {
            let h = block.fc1.forward(activation::relu(block.fc0.forward(x.clone())));
            x = block.ln.forward(x + h);
        }
        let global = self.to_global.forward(x.clone());
        let width = global.dims()[1];
        (self.to_nodes.forward(x).reshape([b * N, width]), global)
    }
}

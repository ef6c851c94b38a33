//! Policy and value heads (paper, sections "Policy" and "Critic" and the listing).

use blueprints::N_BLOCKS as N;
use burn::module::Module;
use burn::nn::Linear;
use burn::tensor::{Tensor, activation};

use super::layers::{Builder, Kernel};
use crate::config::{MIN_STD, MoveHead, NetworkConfig};
use crate::distribution::MOVE;
use crate::features::FeatureSizes;
use crate::mixture::N_READOUTS;
use crate::parameters::Initializer;

/// Gaussians of the moves of B scenes.
#[derive(Clone, Debug)]
pub struct MoveTensors {
    /// Means `[B, 16, 6]`, fractions of the speed limits.
    pub locs: Tensor<3>,
    /// Standard deviations `[B, 16, 6]`, above 0.
    pub scales: Tensor<3>,
}

/// Maps node and global vectors to the action distribution.
#[derive(Module, Debug)]
pub(super) struct PolicyHead {
    input_global: Kernel,
    act_loc: Option<Linear>,
    act_scale: Option<Linear>,
    grip_key: Kernel,
    block_key: Kernel,
    proposals: Option<Linear>,
    #[module(skip)]
    std_offset: f32,
}

/// Maps global vectors and the block choice to the value.
#[derive(Module, Debug)]
pub(super) struct ValueHead {
    input_global: Kernel,
    graph_global: Kernel,
    mlp: Vec<Linear>,
}

impl PolicyHead {
    pub(super) fn build(builder: &mut Builder<'_>, config: &NetworkConfig, sizes: &FeatureSizes) -> Self {
        let (width, grippers) = (config.width, sizes.n_grippers);
        let init = Initializer::HaikuLinear;
        let gaussian = |builder: &mut Builder<'_>, name| {
            let is_gaussian = config.move_head == MoveHead::Gaussian;
            is_gaussian.then(|| builder.linear(name, [width, MOVE], Initializer::FanIn(1e-4)))
        };
        Self {
            input_global: builder.kernel("head.input_global", [sizes.global, width], init),
            act_loc: gaussian(builder, "head.act_loc"),
            act_scale: gaussian(builder, "head.act_scale"),
            grip_key: builder.kernel("head.grip_key", [2 * width, grippers * width], init),
            block_key: builder.kernel("head.block_key", [width + grippers, width], init),
            proposals: (config.move_head == MoveHead::Mixture)
                .then(|| builder.linear("head.proposals", [width, N_READOUTS], Initializer::FanIn(0.1))),
            std_offset: config.std_offset(),
        }
    }

    /// Computes the logits of the choices of blocks.
    ///
    /// # Shapes
    /// nodes `[B·16, w]`, global `[B, w]`, raw globals `[B, gd]` → `[B, G, 16]`
    pub(super) fn logits(&self, nodes: &Tensor<2>, global: &Tensor<2>, raw: &Tensor<2>) -> Tensor<3> {
        let [b, width] = global.dims();
        let grippers = self.block_key.dims()[0] - width;
        let own = raw.clone().matmul(self.input_global.val());
        let grip = Tensor::cat(vec![own, global.clone()], 1).matmul(self.grip_key.val());
        let held = held_bits(raw, grippers).reshape([b * N, grippers]);
        let keys = Tensor::cat(vec![nodes.clone(), held], 1).matmul(self.block_key.val()).reshape([b, N, width]);
        grip.reshape([b, grippers, width]).matmul(keys.swap_dims(1, 2)).div_scalar((width as f32).sqrt())
    }

    /// Computes the Gaussians of the moves; `None` for the mixture head.
    ///
    /// # Shapes
    /// nodes `[B·16, w]` → `[B, 16, 6]`
    pub(super) fn moves(&self, nodes: &Tensor<2>) -> Option<MoveTensors> {
        let shape = [nodes.dims()[0] / N, N, MOVE];
        let locs = self.act_loc.as_ref()?.forward(nodes.clone());
        let x = self.act_scale.as_ref()?.forward(nodes.clone()).add_scalar(self.std_offset);
        let scales = activation::softplus(x, 1.0).add_scalar(MIN_STD);
        Some(MoveTensors { locs: locs.reshape(shape), scales: scales.reshape(shape) })
    }

    /// Reads out what the mixture head's logits are sums of; `None` for the Gaussian head.
    ///
    /// # Shapes
    /// nodes `[B·16, w]` → `[B, 16, N_READOUTS]`
    pub(super) fn readouts(&self, nodes: &Tensor<2>) -> Option<Tensor<3>> {
        let rows = nodes.dims()[0];
        let linear = self.proposals.as_ref()?;
        Some(linear.forward(nodes.clone()).reshape([rows / N, N, N_READOUTS]))
    }
}

impl ValueHead {
    pub(super) fn build(builder: &mut Builder<'_>, config: &NetworkConfig, sizes: &FeatureSizes) -> Self {
        let (width, grippers) = (config.width, sizes.n_grippers);
        let init = Initializer::HaikuLinear;
        let mut widths = vec![2 * width + grippers * N];
        widths.extend(&config.value_hidden);
        widths.push(1);
        Self {
            input_global: builder.kernel("value.input_global", [sizes.global, width], init),
            graph_global: builder.kernel("value.graph_global", [width, width], init),
            mlp: builder.mlp("value.mlp", &widths),
        }
    }

    /// No gradient flows into `logits`, so that the value does not affect the choice of blocks (listing).
    ///
    /// # Shapes
    /// global `[B, w]`, raw globals `[B, gd]`, logits `[B, G, 16]` → `[B]`
    pub(super) fn forward(&self, global: &Tensor<2>, raw: &Tensor<2>, logits: &Tensor<3>) -> Tensor<1> {
        let choice = activation::softmax(logits.clone().detach(), 2).flatten::<2>(1, 2);
        let own = raw.clone().matmul(self.input_global.val());
        let graph = global.clone().matmul(self.graph_global.val());
        let mut x = Tensor::cat(vec![own, graph, choice], 1);
        for (j, layer) in self.mlp.iter().enumerate() {
            x = layer.forward(if j == 0 { x } else { activation::relu(x) });
        }
        x.squeeze_dim(1)
    }
}

/// Returns which gripper held which block: the last 16 entries of each gripper's part of the raw globals.
///
/// # Shapes
/// `[B, gd]` → `[B, 16, G]`
fn held_bits(raw: &Tensor<2>, grippers: usize) -> Tensor<3> {
    let [b, gd] = raw.dims();
    let part = gd / grippers;
    raw.clone().reshape([b, grippers, part]).slice([0..b, 0..grippers, part - N..part]).swap_dims(1, 2)
}

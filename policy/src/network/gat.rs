//! The graph-attention encoder (paper, section "Graph Neural Network Encoder" and its listing), computed folded.
//!
//! The listing encodes every edge to 64 numbers and computes a query and a message of 256 numbers from each. All these
//! maps are linear, so they can be moved to where there are few rows. For receiver r, sender s, head h, with raw edge
//! features x, edge encoder (E, b), query kernel split by rows (Qn, Qe), key kernel K, message kernel (Mn, Me), output
//! kernel O:
//!
//! - logit · √d = (nₛQn + (xE + b)Qe) · (nᵣK) = nₛ · (nᵣ K Qnᵀ) + x · (nᵣ K Qeᵀ Eᵀ) + a term that does not depend on s
//!   and so cancels in the softmax over s: the matrices `K Qnᵀ` and `K Qeᵀ Eᵀ` act on 16 nodes instead of 240 edges;
//! - Σₛ w (nₛMn + (xE + b)Me) O = (Σₛ w nₛ) Mn O + (Σₛ w x) E Me O + b Me O, because the weights sum to 1: nodes and
//!   *raw* edge features are averaged first, and the projections act on 16 rows.
//!
//! The result equals the unfolded form up to rounding; tests compare it with the listing's numbers. In training, folding
//! is part of the autodiff graph; for inference, it is done once per weights version.

use blueprints::N_BLOCKS as N;
use burn::module::Module;
use burn::nn::{LayerNorm, Linear};
use burn::tensor::{Device, Tensor, TensorData, activation};

use super::BatchTensors;
use super::layers::{Builder, Kernel, bias};
use crate::config::GatConfig;
use crate::features::FeatureSizes;
use crate::parameters::Initializer;

/// Added to the logit of an edge that does not exist.
const NO_EDGE: f32 = -1e9;

/// The graph encoder's parameters.
#[derive(Module, Debug)]
pub(super) struct GatEncoder {
    embed_node: Linear,
    embed_edge: Linear,
    embed_global: Linear,
    layers: Vec<GatLayer>,
    #[module(skip)]
    config: GatConfig,
}

/// Parameters of one layer; layers do not share parameters.
#[derive(Module, Debug)]
struct GatLayer {
    message: Kernel,
    query: Option<Kernel>,
    key: Option<Kernel>,
    node_proj: Kernel,
    ln_attn: LayerNorm,
    mlp_node: Vec<Linear>,
    ln_mlp: LayerNorm,
    mlp_global: Vec<Linear>,
    ln_global: LayerNorm,
}

/// The edge path of one layer after folding, for H heads, width w, and `ed` raw edge features.
#[derive(Clone, Debug)]
pub(super) struct FoldedLayer {
    /// `[w, H·w]` and `[w, H·ed]`: map a receiver to the vectors compared with its senders and its edges, scaled by
    /// 1/√d. `None` without attention.
    attend: Option<[Tensor<2>; 2]>,
    /// `[H·w, w]`, or `[w, w]` without attention: maps averaged senders to the residual.
    from_nodes: Tensor<2>,
    /// `[H·ed, w]`, or `[ed, w]` without attention: maps averaged raw edge features to the residual.
    from_edges: Tensor<2>,
    /// `[1, w]`: the edge encoder's bias, mapped to the residual.
    constant: Tensor<2>,
    /// First layer of the node MLP, split by rows: `[w, hidden]` for the node, `[w, hidden]` for the global.
    mlp_node: [Tensor<2>; 2],
}

impl GatEncoder {
    pub(super) fn build(builder: &mut Builder<'_>, config: &GatConfig, width: usize, sizes: &FeatureSizes) -> Self {
        let init = Initializer::HaikuLinear;
        let inner = config.n_heads * config.head_dim;
        let embed_node = builder.linear("embed_node", [sizes.node, width], init);
        let embed_edge = builder.linear("embed_edge", [sizes.edge, width], init);
        let embed_global = builder.linear("embed_global", [sizes.global, width], init);
        let layers = (0..config.n_layers)
            .map(|l| {
                let name = |part: &str| format!("layer{l}.{part}");
                let mlp = [2 * width, config.mlp_hidden, width];
                GatLayer {
                    message: builder.kernel(&name("message"), [2 * width, inner], init),
                    query: config.attention.then(|| builder.kernel(&name("query"), [2 * width, inner], init)),
                    key: config.attention.then(|| builder.kernel(&name("key"), [width, inner], init)),
                    node_proj: builder.kernel(&name("node_proj"), [inner, width], init),
                    ln_attn: builder.layer_norm(&name("ln_attn"), width),
                    mlp_node: builder.mlp(&name("mlp_node"), &mlp),
                    ln_mlp: builder.layer_norm(&name("ln_mlp"), width),
                    mlp_global: builder.mlp(&name("mlp_global"), &mlp),
                    ln_global: builder.layer_norm(&name("ln_global"), width),
                }
            })
            .collect();
        Self { embed_node, embed_edge, embed_global, layers, config: *config }
    }

    /// Multiplies consecutive matrices that have no nonlinearity between them.
    pub(super) fn fold(&self) -> Vec<FoldedLayer> {
        self.layers.iter().map(|layer| self.fold_layer(layer)).collect()
    }

    fn fold_layer(&self, layer: &GatLayer) -> FoldedLayer {
        let GatConfig { n_heads, head_dim, .. } = self.config;
        let [_, width] = layer.node_proj.dims();
        let [ed, _] = self.embed_edge.weight.dims();
        let embed = self.embed_edge.weight.val();
        // Rows of a two-part kernel, split by head: `[H, width, head_dim]`.
        let by_head = |w: Tensor<2>, part: usize| {
            w.slice_dim(0, part * width..(part + 1) * width).reshape([width, n_heads, head_dim]).swap_dims(0, 1)
        };
        let attend = layer.query.as_ref().zip(layer.key.as_ref()).map(|(query, key)| {
            let key = by_head(key.val(), 0).div_scalar((head_dim as f32).sqrt());
            let [to_node, to_edge] = [0, 1].map(|part| key.clone().matmul(by_head(query.val(), part).swap_dims(1, 2)));
            let to_edge = to_edge.matmul(embed.clone().transpose().unsqueeze::<3>());
            [
                to_node.swap_dims(0, 1).reshape([width, n_heads * width]),
                to_edge.swap_dims(0, 1).reshape([width, n_heads * ed]),
            ]
        });
        let project = layer.node_proj.val().reshape([n_heads, head_dim, width]);
        let [from_nodes, from_embedded] = [0, 1].map(|part| by_head(layer.message.val(), part).matmul(project.clone()));
        let constant = bias(&self.embed_edge).matmul(from_embedded.clone().sum_dim(0).squeeze_dim::<2>(0));
        let from_edges = embed.unsqueeze::<3>().matmul(from_embedded);
        let (from_nodes, from_edges) = if attend.is_some() {
            (from_nodes.reshape([n_heads * width, width]), from_edges.reshape([n_heads * ed, width]))
        } else {
            // All heads compute the same average, so their projections add up.
            (from_nodes.sum_dim(0).squeeze_dim(0), from_edges.sum_dim(0).squeeze_dim(0))
        };
        let mlp = layer.mlp_node[0].weight.val();
        let mlp_node = [mlp.clone().slice_dim(0, 0..width), mlp.slice_dim(0, width..2 * width)];
        FoldedLayer { attend, from_nodes, from_edges, constant, mlp_node }
    }

    /// Encodes a batch.
    ///
    /// # Shapes
    /// Input as in [`BatchTensors`]; output nodes `[B·16, width]` and globals `[B, width]`.
    pub(super) fn forward(&self, folded: &[FoldedLayer], batch: &BatchTensors) -> (Tensor<2>, Tensor<2>) {
        assert_eq!(folded.len(), self.layers.len(), "folded weights of this encoder");
        let [b, _, nd] = batch.nodes.dims();
        let mut nodes = self.embed_node.forward(batch.nodes.clone().reshape([b * N, nd]));
        let mut global = self.embed_global.forward(batch.globals.clone());
        let edges = batch.edges_by_receiver();
        let no_edge = diagonal(&nodes.device());
        let mean_edges = (!self.config.attention).then(|| mean_edges(&edges));
        for (layer, folded) in self.layers.iter().zip(folded) {
            let residual = match (&folded.attend, &mean_edges) {
                (Some(attend), _) => self.attended(&nodes, &edges, attend, &no_edge, folded),
                (None, Some(mean_edges)) => averaged(&nodes, mean_edges, folded),
                (None, None) => unreachable!("folding gives attention exactly when the configuration has it"),
            };
            let y = layer.ln_attn.forward(nodes + residual);
            nodes = layer.update_nodes(folded, y, global.clone());
            global = layer.update_global(&nodes, global);
        }
        (nodes, global)
    }

    /// Returns the residual of all nodes, `[B·16, w]`, with the softmax weights over the incoming edges of each.
    fn attended(
        &self,
        nodes: &Tensor<2>,
        edges: &Tensor<3>,
        [to_node, to_edge]: &[Tensor<2>; 2],
        no_edge: &Tensor<4>,
        folded: &FoldedLayer,
    ) -> Tensor<2> {
        let heads = self.config.n_heads;
        let [rows, width] = nodes.dims();
        let ed = edges.dims()[2];
        let b = rows / N;
        let senders = nodes.clone().reshape([b, N, width]);
        let by_node = nodes.clone().matmul(to_node.clone()).reshape([b, N * heads, width]);
        let by_edge = nodes.clone().matmul(to_edge.clone()).reshape([rows, heads, ed]);
        let logits = by_node.matmul(senders.swap_dims(1, 2)).reshape([b, N, heads, N])
            + by_edge.matmul(edges.clone().swap_dims(1, 2)).reshape([b, N, heads, N]);
        // `[B, 16, H, 16]`
        let weights = activation::softmax(logits + no_edge.clone(), 3);
        // Reshaped anew: a shared tensor would change the order in which gradients are summed.
        let senders = nodes.clone().reshape([b, N, width]);
        let mean_nodes = weights.clone().reshape([b, N * heads, N]).matmul(senders);
        let mean_edges = weights.reshape([rows, heads, N]).matmul(edges.clone());
        mean_nodes.reshape([rows, heads * width]).matmul(folded.from_nodes.clone())
            + mean_edges.reshape([rows, heads * ed]).matmul(folded.from_edges.clone())
            + folded.constant.clone()
    }
}

/// Returns the residual of all nodes, `[B·16, w]`, with equal weights.
fn averaged(nodes: &Tensor<2>, mean_edges: &Tensor<2>, folded: &FoldedLayer) -> Tensor<2> {
    let [rows, width] = nodes.dims();
    let each = nodes.clone().reshape([rows / N, N, width]);
    let mean = (each.clone().sum_dim(1) - each).div_scalar((N - 1) as f32);
    mean.reshape([rows, width]).matmul(folded.from_nodes.clone())
        + mean_edges.clone().matmul(folded.from_edges.clone())
        + folded.constant.clone()
}

/// Returns the mean raw features of the incoming edges of each node, `[B·16, ed]`; absent edges are zeros.
fn mean_edges(edges: &Tensor<3>) -> Tensor<2> {
    edges.clone().sum_dim(1).squeeze_dim::<2>(1).div_scalar((N - 1) as f32)
}

impl GatLayer {
    /// Node MLP on (node, its graph's global) with residual and LayerNorm.
    ///
    /// # Shapes
    /// y `[B·16, w]`, global `[B, w]` → `[B·16, w]`
    fn update_nodes(&self, folded: &FoldedLayer, y: Tensor<2>, global: Tensor<2>) -> Tensor<2> {
        let [rows, width] = y.dims();
        let [on_node, on_global] = &folded.mlp_node;
        // The global's half of the first layer is computed once per graph, not per node.
        let shared = global.matmul(on_global.clone()) + bias(&self.mlp_node[0]);
        let [b, hidden] = shared.dims();
        let own = y.clone().matmul(on_node.clone()).reshape([b, N, hidden]);
        let h = activation::relu(own + shared.unsqueeze_dim(1)).reshape([rows, hidden]);
        self.ln_mlp.forward(self.mlp_node[1].forward(h).reshape([rows, width]) + y)
    }

    /// Global MLP on (global, sum of the nodes) with residual and LayerNorm.
    ///
    /// # Shapes
    /// nodes `[B·16, w]`, global `[B, w]` → `[B, w]`
    fn update_global(&self, nodes: &Tensor<2>, global: Tensor<2>) -> Tensor<2> {
        let [b, width] = global.dims();
        let sum = nodes.clone().reshape([b, N, width]).sum_dim(1).squeeze_dim::<2>(1);
        let input = Tensor::cat(vec![global.clone(), sum], 1);
        let h = activation::relu(self.mlp_global[0].forward(input));
        self.ln_global.forward(self.mlp_global[1].forward(h) + global)
    }
}

/// `[1, 16, 1, 16]`: [`NO_EDGE`] where receiver and sender are the same block.
fn diagonal(device: &Device) -> Tensor<4> {
    let values: Vec<f32> = (0..N * N).map(|i| if i / N == i % N { NO_EDGE } else { 0.0 }).collect();
    Tensor::from_data(TensorData::new(values, [1, N, 1, N]), device)
}

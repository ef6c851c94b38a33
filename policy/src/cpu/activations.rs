//! Inputs and activations of a pass over a few graphs.

use blueprints::N_BLOCKS as N;

use super::ops::Normalized;
use super::spans::Shape;
use crate::FeatureBatch;
use crate::features::N_EDGES;
use crate::network::listed_index;

/// Number of graphs encoded together: their activations for the backward pass fit into the L2 cache.
pub(super) const GRAPHS: usize = 8;

/// Activations of a few graphs; the memory is reused between passes.
#[derive(Clone, Debug, Default)]
pub(super) struct Activations {
    /// Number of graphs b; `rows` below is 16 b.
    pub(super) n: usize,
    /// Whether the first layer attends to raw features.
    pub(super) is_raw: bool,
    /// Raw features followed by a 1, `[rows, nd + 1]`.
    pub(super) raw: Vec<f32>,
    /// `[rows, 16, ed]` and `[rows, ed, 16]`; see `attend`.
    pub(super) edges: Vec<f32>,
    pub(super) edges_t: Vec<f32>,
    /// `[b, gd]`
    pub(super) raw_global: Vec<f32>,
    /// `[rows, w]` and `[b, w]`
    pub(super) embedded: Vec<f32>,
    pub(super) embedded_global: Vec<f32>,
    pub(super) layers: Vec<LayerActivations>,
    /// Input of the grippers' keys `[b, 2w]`, the keys `[b, G, w]`, and the blocks' keys `[rows, w]`.
    pub(super) grip_input: Vec<f32>,
    pub(super) grip: Vec<f32>,
    pub(super) block_keys: Vec<f32>,
}

/// Activations of one layer with h hidden units and H heads.
#[derive(Clone, Debug, Default)]
pub(super) struct LayerActivations {
    /// `[rows, H, n]`, `[rows, H, ed]`, and `[rows, H, 16]`; see `attend`.
    pub(super) compare_nodes: Vec<f32>,
    pub(super) compare_edges: Vec<f32>,
    pub(super) weights: Vec<f32>,
    /// `[rows, H, n]` and `[rows, H, ed]`
    pub(super) mean_nodes: Vec<f32>,
    pub(super) mean_edges: Vec<f32>,
    pub(super) ln_attn: Normalized,
    /// After the attention, `[rows, w]`.
    pub(super) attended: Vec<f32>,
    /// `[rows, h]`
    pub(super) hidden: Vec<f32>,
    pub(super) ln_mlp: Normalized,
    /// `[rows, w]`
    pub(super) nodes: Vec<f32>,
    /// `[b, 2w]` and `[b, h]`
    pub(super) global_input: Vec<f32>,
    pub(super) global_hidden: Vec<f32>,
    pub(super) ln_global: Normalized,
    /// `[b, w]`
    pub(super) global: Vec<f32>,
}

impl Activations {
    /// Reads the features of `rows` of a batch.
    pub(super) fn read(&mut self, shape: &Shape, batch: &FeatureBatch, rows: &[usize]) {
        let (nd, ed, gd) = (batch.sizes.node, batch.sizes.edge, batch.sizes.global);
        self.n = rows.len();
        self.is_raw = shape.attends_to_raw(0);
        self.raw.clear();
        self.raw_global.clear();
        self.edges.resize(rows.len() * N * N * ed, 0.0);
        self.edges_t.resize(rows.len() * N * N * ed, 0.0);
        self.layers.resize_with(shape.gat.n_layers, LayerActivations::default);
        let per_graph = N_EDGES * ed;
        for (graph, &row) in rows.iter().enumerate() {
            for node in batch.nodes[row * N * nd..(row + 1) * N * nd].chunks_exact(nd) {
                self.raw.extend_from_slice(node);
                self.raw.push(1.0);
            }
            self.raw_global.extend_from_slice(&batch.globals[row * gd..(row + 1) * gd]);
            let listed = &batch.edges[row * per_graph..(row + 1) * per_graph];
            let graph = graph * N * N * ed..(graph + 1) * N * N * ed;
            let edges = &mut self.edges[graph.clone()];
            let edges_t = &mut self.edges_t[graph];
            let receivers = edges.chunks_exact_mut(N * ed).zip(edges_t.chunks_exact_mut(N * ed));
            for (receiver, (edges, edges_t)) in receivers.enumerate() {
                for (sender, edge) in edges.chunks_exact_mut(ed).enumerate() {
                    match listed_index(sender, receiver) {
                        Some(i) => edge.copy_from_slice(&listed[i * ed..(i + 1) * ed]),
                        None => edge.fill(0.0),
                    }
                }
                for (k, entries) in edges_t.as_chunks_mut::<N>().0.iter_mut().enumerate() {
                    *entries = std::array::from_fn(|sender| edges[sender * ed + k]);
                }
            }
        }
    }
}

//! Attention over 16 nodes and the edges between them, forward and backward, one graph at a time.

use blueprints::N_BLOCKS as N;
use pulp::{Simd, WithSimd};

use super::matmul::{Base, small_add_transposed, small_product};
use super::ops::{softmax, softmax_backward};

/// Input of both passes; `n` is the length of a node's vector, `rows` the number of nodes of all graphs.
#[derive(Clone, Copy)]
pub(super) struct Graphs<'a> {
    pub(super) n_heads: usize,
    pub(super) n: usize,
    pub(super) ed: usize,
    /// `[rows, n]`
    pub(super) nodes: &'a [f32],
    /// The 16 edges of each receiver, `[rows, 16, ed]`, with zeros for edges that do not exist.
    pub(super) edges: &'a [f32],
    /// `edges` transposed, `[rows, ed, 16]`.
    pub(super) edges_t: &'a [f32],
    /// Vectors compared with senders and edges, `[rows, H, n]` and `[rows, H, ed]`.
    pub(super) compare_nodes: &'a [f32],
    pub(super) compare_edges: &'a [f32],
}

/// Writes the weights `[rows, H, 16]` and the weighted means of senders and edges, `[rows, H, n]` and `[rows, H, ed]`.
pub(super) struct Attend<'a> {
    pub(super) graphs: Graphs<'a>,
    pub(super) weights: &'a mut [f32],
    pub(super) means: [&'a mut [f32]; 2],
}

/// Computes the gradients of the compared vectors from those of the means. If `nodes` is given, adds the part of the
/// senders' gradient that flows through this layer's attention, `[rows, n]`.
pub(super) struct AttendBackward<'a> {
    pub(super) graphs: Graphs<'a>,
    pub(super) weights: &'a [f32],
    pub(super) means: [&'a [f32]; 2],
    pub(super) compare: [&'a mut [f32]; 2],
    pub(super) nodes: Option<&'a mut [f32]>,
}

impl WithSimd for Attend<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { graphs, weights, means: [mean_nodes, mean_edges] } = self;
        let Graphs { n_heads, n, ed, .. } = graphs;
        let per_node = n_heads * N;
        let mut senders = vec![0.0; n * N];
        for (graph, weights) in weights.chunks_exact_mut(N * per_node).enumerate() {
            let nodes = graph_of(graphs.nodes, n, graph);
            transpose(nodes, n, &mut senders);
            small_product(simd, graph_of(graphs.compare_nodes, n_heads * n, graph), &senders, n, Base::Zero, weights);
            for (receiver, weights) in weights.chunks_exact_mut(per_node).enumerate() {
                let row = graph * N + receiver;
                let compare = &graphs.compare_edges[row * n_heads * ed..][..n_heads * ed];
                small_product(simd, compare, &graphs.edges_t[row * ed * N..][..ed * N], ed, Base::Kept, weights);
                weights.as_chunks_mut::<N>().0.iter_mut().for_each(|weights| softmax(weights, Some(receiver)));
                let mean = &mut mean_edges[row * n_heads * ed..][..n_heads * ed];
                small_product(simd, weights, &graphs.edges[row * N * ed..][..N * ed], N, Base::Zero, mean);
            }
            let mean = &mut mean_nodes[graph * N * n_heads * n..][..N * n_heads * n];
            small_product(simd, weights, nodes, N, Base::Zero, mean);
        }
    }
}

impl WithSimd for AttendBackward<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { graphs, weights, means: [mean_nodes, mean_edges], compare: [of_nodes, of_edges], mut nodes } = self;
        let Graphs { n_heads, n, ed, .. } = graphs;
        let per_node = n_heads * N;
        let mut senders = vec![0.0; n * N];
        let mut logits = vec![0.0; N * per_node];
        for (graph, weights) in weights.chunks_exact(N * per_node).enumerate() {
            let values = graph_of(graphs.nodes, n, graph);
            transpose(values, n, &mut senders);
            let mean = graph_of(mean_nodes, n_heads * n, graph);
            small_product(simd, mean, &senders, n, Base::Zero, &mut logits);
            for (receiver, logits) in logits.chunks_exact_mut(per_node).enumerate() {
                let row = graph * N + receiver;
                let edges = row * n_heads * ed..(row + 1) * n_heads * ed;
                let edges_t = &graphs.edges_t[row * ed * N..][..ed * N];
                small_product(simd, &mean_edges[edges.clone()], edges_t, ed, Base::Kept, logits);
                let weights = weights[receiver * per_node..].as_chunks::<N>().0;
                let pairs = weights.iter().zip(logits.as_chunks_mut::<N>().0);
                pairs.for_each(|(weights, logits)| softmax_backward(weights, logits));
                let values = &graphs.edges[row * N * ed..][..N * ed];
                small_product(simd, logits, values, N, Base::Zero, &mut of_edges[edges]);
            }
            let compared = graph * N * n_heads * n..(graph + 1) * N * n_heads * n;
            small_product(simd, &logits, values, N, Base::Zero, &mut of_nodes[compared.clone()]);
            if let Some(nodes) = &mut nodes {
                let nodes = &mut nodes[graph * N * n..][..N * n];
                small_add_transposed(simd, weights, N, mean, n, nodes);
                small_add_transposed(simd, &logits, N, &graphs.compare_nodes[compared], n, nodes);
            }
        }
    }
}

/// Returns the 16 rows of a graph, each of `per_node` numbers.
#[inline(always)]
fn graph_of(values: &[f32], per_node: usize, graph: usize) -> &[f32] {
    &values[graph * N * per_node..][..N * per_node]
}

/// `[16, n]` → `[n, 16]`
#[inline(always)]
fn transpose(nodes: &[f32], n: usize, to: &mut [f32]) {
    for (node, row) in nodes.chunks_exact(n).enumerate() {
        for (to, x) in to.as_chunks_mut::<N>().0.iter_mut().zip(row) {
            to[node] = *x;
        }
    }
}

//! Multiplies the matrices of the attention into each other, and unfolds their gradients.
//!
//! The equations are those of [`crate::network`]'s encoder (`gat.rs`). In addition, the first layer attends to raw node
//! features: its nodes are x̃ Ẽ, where x̃ = (x, 1) and Ẽ is the embedding's kernel with its bias as last row. Its
//! matrices are therefore Ẽ A Ẽᵀ and so on, with a few rows instead of 64.

use pulp::Arch;

use super::matmul::{add_transposed, multiply, multiply_transposed};
use super::spans::{Context, LayerSpans, Span};

/// The matrices of one head of a layer, with w the width, d the head's width, and `ed` and `nd` the numbers of raw
/// features.
#[derive(Clone, Debug)]
struct Head {
    /// The head's parameters, each `[w, d]`; the key is divided by √d.
    key: Vec<f32>,
    query: [Vec<f32>; 2],
    message: [Vec<f32>; 2],
    /// `[d, w]`
    project: Vec<f32>,
    /// `K Qnᵀ` and `K Qeᵀ`, `[w, w]`.
    compare: [Vec<f32>; 2],
    /// `K Qeᵀ Eᵀ`, `[w, ed]`.
    to_edge: Vec<f32>,
    /// `Mn O` and `Me O`, `[w, w]`.
    carry: [Vec<f32>; 2],
}

/// A layer's folded matrices, and the intermediate products that their gradients need.
#[derive(Clone, Debug)]
pub(super) struct Fold {
    heads: Vec<Head>,
    /// Whether nodes are raw features.
    pub(super) is_raw: bool,
    /// Length of a node's vector: w, or nd + 1 for raw features.
    pub(super) n_in: usize,
    pub(super) matrices: Matrices,
}

/// A layer's folded matrices, or their gradients.
#[derive(Clone, Debug, Default)]
pub(super) struct Matrices {
    /// `[n_in, H · n_in]` and `[n_in, H · ed]`
    pub(super) to_node: Vec<f32>,
    pub(super) to_edge: Vec<f32>,
    /// `[H · n_in, w]` and `[H · ed, w]`
    pub(super) from_nodes: Vec<f32>,
    pub(super) from_edges: Vec<f32>,
    /// `[w]`
    pub(super) constant: Vec<f32>,
}

impl Fold {
    pub(super) fn new(net: Context<'_>, layer: usize) -> Self {
        let Context { arch, shape, spans, .. } = net;
        let (w, ed) = (shape.width, shape.sizes.edge);
        let is_raw = shape.attends_to_raw(layer);
        let (embed, embed_edge, edge_bias) =
            (net.of(&spans.embed_node), net.of(&spans.embed_edge.w), net.of(&spans.embed_edge.b));
        let heads: Vec<Head> = (0..shape.n_heads).map(|h| Head::new(net, &spans.layers[layer], h)).collect();
        let n_in = if is_raw { shape.sizes.node + 1 } else { w };
        let mut matrices = Matrices { constant: vec![0.0; w], ..Matrices::default() };
        let (mut to_node, mut to_edge) = (Vec::new(), Vec::new());
        for head in &heads {
            let (compare, edges, carry) = if is_raw {
                let compare = multiply(arch, embed, &head.compare[0], w);
                (
                    multiply_transposed(arch, &compare, embed, w),
                    multiply(arch, embed, &head.to_edge, w),
                    multiply(arch, embed, &head.carry[0], w),
                )
            } else {
                (head.compare[0].clone(), head.to_edge.clone(), head.carry[0].clone())
            };
            to_node.push(compare);
            to_edge.push(edges);
            matrices.from_nodes.extend(carry);
            matrices.from_edges.extend(multiply(arch, embed_edge, &head.carry[1], w));
            add(&mut matrices.constant, &multiply(arch, edge_bias, &head.carry[1], w));
        }
        matrices.to_node = beside(&to_node, n_in);
        matrices.to_edge = beside(&to_edge, ed);
        Self { heads, is_raw, n_in, matrices }
    }

    /// Sets a gradient to zero.
    pub(super) fn clear(&self, gradient: &mut Matrices) {
        let Matrices { to_node, to_edge, from_nodes, from_edges, constant } = gradient;
        for (values, matrix) in [
            (to_node, &self.matrices.to_node),
            (to_edge, &self.matrices.to_edge),
            (from_nodes, &self.matrices.from_nodes),
            (from_edges, &self.matrices.from_edges),
            (constant, &self.matrices.constant),
        ] {
            values.clear();
            values.resize(matrix.len(), 0.0);
        }
    }

    /// Adds the gradients of the parameters from which these matrices are computed.
    pub(super) fn unfold(&self, net: Context<'_>, layer: usize, folded: &Matrices, gradient: &mut [f32]) {
        let Context { arch, shape, spans, .. } = net;
        let (w, ed, d) = (shape.width, shape.sizes.edge, shape.head_dim);
        let n_heads = shape.n_heads;
        let inner = n_heads * d;
        let LayerSpans { message, query, key, node_proj, .. } = &spans.layers[layer];
        let (embed, embed_edge, edge_bias) =
            (net.of(&spans.embed_node), net.of(&spans.embed_edge.w), net.of(&spans.embed_edge.b));
        let scale = 1.0 / (d as f32).sqrt();
        for (h, head) in self.heads.iter().enumerate() {
            let mut compare = columns(&folded.to_node, n_heads * self.n_in, h * self.n_in, self.n_in);
            let mut to_edge = columns(&folded.to_edge, n_heads * ed, h * ed, ed);
            let mut carry = folded.from_nodes[h * self.n_in * w..(h + 1) * self.n_in * w].to_vec();
            let from_edges = &folded.from_edges[h * ed * w..(h + 1) * ed * w];
            if self.is_raw {
                // The gradient of Ẽ in Ẽ A Ẽᵀ is G Ẽ Aᵀ + Gᵀ Ẽ A; that of A is Ẽᵀ G Ẽ.
                let left = multiply_transposed(arch, embed, &head.compare[0], w);
                let right = multiply(arch, embed, &head.compare[0], w);
                let mut embedding = multiply(arch, &compare, &left, self.n_in);
                add(&mut embedding, &transposed_multiply(arch, &compare, self.n_in, &right, w));
                add(&mut embedding, &multiply_transposed(arch, &to_edge, &head.to_edge, ed));
                add(&mut embedding, &multiply_transposed(arch, &carry, &head.carry[0], w));
                add(&mut gradient[spans.embed_node.clone()], &embedding);
                let inside = multiply(arch, &compare, embed, self.n_in);
                compare = transposed_multiply(arch, embed, w, &inside, w);
                to_edge = transposed_multiply(arch, embed, w, &to_edge, ed);
                carry = transposed_multiply(arch, embed, w, &carry, w);
            }
            let compare_edge = multiply(arch, &to_edge, embed_edge, ed);
            if let Some((key, query)) = key.as_ref().zip(query.as_ref()) {
                let mut of_key = multiply(arch, &compare, &head.query[0], w);
                add(&mut of_key, &multiply(arch, &compare_edge, &head.query[1], w));
                of_key.iter_mut().for_each(|g| *g *= scale);
                add_columns(&mut gradient[key.clone()], inner, h * d, &of_key, d);
                for (part, compare) in [&compare, &compare_edge].into_iter().enumerate() {
                    let of_query = transposed_multiply(arch, compare, w, &head.key, d);
                    add_columns(&mut gradient[query.clone()][part * w * inner..], inner, h * d, &of_query, d);
                }
            }
            // The edge encoder's bias reaches the residual only through Me O.
            let mut carry_edge = transposed_multiply(arch, embed_edge, w, from_edges, w);
            for (row, bias) in carry_edge.chunks_exact_mut(w).zip(edge_bias) {
                row.iter_mut().zip(&folded.constant).for_each(|(g, c)| *g += bias * c);
            }
            let mut of_edge = transposed_multiply(arch, &to_edge, ed, &head.compare[1], w);
            add(&mut of_edge, &multiply_transposed(arch, from_edges, &head.carry[1], w));
            add(&mut gradient[spans.embed_edge.w.clone()], &of_edge);
            let of_bias = multiply_transposed(arch, &folded.constant, &head.carry[1], w);
            add(&mut gradient[spans.embed_edge.b.clone()], &of_bias);
            for (part, carry) in [&carry, &carry_edge].into_iter().enumerate() {
                let of_message = multiply_transposed(arch, carry, &head.project, w);
                add_columns(&mut gradient[message.clone()][part * w * inner..], inner, h * d, &of_message, d);
                let of_project = transposed_multiply(arch, &head.message[part], d, carry, w);
                add(&mut gradient[node_proj.clone()][h * d * w..(h + 1) * d * w], &of_project);
            }
        }
    }
}

impl Head {
    fn new(net: Context<'_>, layer: &LayerSpans, h: usize) -> Self {
        let Context { arch, shape, spans, .. } = net;
        let (w, d) = (shape.width, shape.head_dim);
        let inner = shape.n_heads * d;
        let by_head = |span: &Span, part: usize| -> Vec<f32> {
            columns(&net.of(span)[part * w * inner..(part + 1) * w * inner], inner, h * d, d)
        };
        let scale = 1.0 / (d as f32).sqrt();
        // Without attention, keys and queries of zeros give all edges the same weight.
        let or_zeros = |span: &Option<Span>, part: usize| {
            span.as_ref().map_or_else(|| vec![0.0; w * d], |span| by_head(span, part))
        };
        let key: Vec<f32> = or_zeros(&layer.key, 0).into_iter().map(|k| k * scale).collect();
        let query = [0, 1].map(|part| or_zeros(&layer.query, part));
        let message = [0, 1].map(|part| by_head(&layer.message, part));
        let project = net.of(&layer.node_proj)[h * d * w..(h + 1) * d * w].to_vec();
        let compare = [0, 1].map(|part: usize| multiply_transposed(arch, &key, &query[part], d));
        let to_edge = multiply_transposed(arch, &compare[1], net.of(&spans.embed_edge.w), w);
        let carry = [0, 1].map(|part: usize| multiply(arch, &message[part], &project, d));
        Self { key, query, message, project, compare, to_edge, carry }
    }
}

/// Computes `aᵀ · b`.
///
/// # Shapes
/// a `[rows, m]`, b `[rows, n]` → `[m, n]`
fn transposed_multiply(arch: Arch, a: &[f32], m: usize, b: &[f32], n: usize) -> Vec<f32> {
    let mut c = vec![0.0; m * n];
    add_transposed(arch, a, m, b, n, &mut c);
    c
}

fn add(to: &mut [f32], from: &[f32]) {
    debug_assert_eq!(to.len(), from.len());
    to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
}

/// Concatenates matrices of `n` columns horizontally.
fn beside(matrices: &[Vec<f32>], n: usize) -> Vec<f32> {
    let n_rows = matrices.first().map_or(0, |matrix| matrix.len() / n);
    (0..n_rows).flat_map(|row| matrices.iter().flat_map(move |m| m[row * n..(row + 1) * n].iter().copied())).collect()
}

/// Returns the columns `first..first + n` of a matrix with `n_all` columns.
pub(super) fn columns(matrix: &[f32], n_all: usize, first: usize, n: usize) -> Vec<f32> {
    matrix.chunks_exact(n_all).flat_map(|row| row[first..first + n].iter().copied()).collect()
}

/// Adds a matrix of `n` columns to the columns starting at `first`.
fn add_columns(to: &mut [f32], n_all: usize, first: usize, from: &[f32], n: usize) {
    for (to, from) in to.chunks_exact_mut(n_all).zip(from.chunks_exact(n)) {
        add(&mut to[first..first + n], from);
    }
}

//! One layer of the encoder: attention, node MLP, and global MLP.

use super::activations::{Activations, LayerActivations};
use super::attend::{Attend, AttendBackward, Graphs};
use super::fold::{Fold, Matrices};
use super::matmul::{Base, Packed, add_transposed, product};
use super::ops::{add_rows, add_to_nodes, layer_norm, layer_norm_backward, relu_backward, sum_nodes};
use super::spans::{Context, LayerSpans, Linear, Norm, Shape};

/// A layer's kernels, packed for multiplication.
#[derive(Clone, Debug)]
pub(super) struct Layer {
    spans: LayerSpans,
    pub(super) fold: Fold,
    forward: Kernels,
    /// Transposes; present only if gradients are needed.
    backward: Option<Kernels>,
}

/// Kernels of a layer, or their transposes.
#[derive(Clone, Debug)]
struct Kernels {
    to_node: Packed,
    to_edge: Packed,
    from_nodes: Packed,
    from_edges: Packed,
    /// The first layer of the node MLP, split by rows: those for the node and those for its global.
    mlp_node: [Packed; 2],
    mlp_node_out: Packed,
    mlp_global: [Packed; 2],
}

/// Gradients that flow backward through a layer, from its output to its input.
#[derive(Clone, Debug, Default)]
pub(super) struct Flow {
    /// `[rows, w]`
    pub(super) nodes: Vec<f32>,
    /// `[b, w]`
    pub(super) global: Vec<f32>,
    hidden: Vec<f32>,
    shared: Vec<f32>,
    global_hidden: Vec<f32>,
    global_input: Vec<f32>,
    means: [Vec<f32>; 2],
    compare: [Vec<f32>; 2],
}

impl Kernels {
    fn new(net: Context<'_>, spans: &LayerSpans, fold: &Fold, pack: impl Fn(&[f32], [usize; 2]) -> Packed) -> Self {
        let shape = net.shape;
        let (w, ed, heads, hidden) = (shape.width, shape.sizes.edge, shape.n_heads, shape.gat.mlp_hidden);
        let (on_node, on_graph) = net.of(&spans.mlp_node[0].w).split_at(w * hidden);
        Self {
            to_node: pack(&fold.matrices.to_node, [fold.n_in, heads * fold.n_in]),
            to_edge: pack(&fold.matrices.to_edge, [fold.n_in, heads * ed]),
            from_nodes: pack(&fold.matrices.from_nodes, [heads * fold.n_in, w]),
            from_edges: pack(&fold.matrices.from_edges, [heads * ed, w]),
            mlp_node: [pack(on_node, [w, hidden]), pack(on_graph, [w, hidden])],
            mlp_node_out: pack(net.of(&spans.mlp_node[1].w), [hidden, w]),
            mlp_global: [
                pack(net.of(&spans.mlp_global[0].w), [2 * w, hidden]),
                pack(net.of(&spans.mlp_global[1].w), [hidden, w]),
            ],
        }
    }
}

impl Layer {
    pub(super) fn new(net: Context<'_>, layer: usize, with_gradients: bool) -> Self {
        let fold = Fold::new(net, layer);
        let spans = net.spans.layers[layer].clone();
        Self {
            forward: Kernels::new(net, &spans, &fold, Packed::new),
            backward: with_gradients.then(|| Kernels::new(net, &spans, &fold, Packed::transposed)),
            spans,
            fold,
        }
    }

    /// Computes layer `l` of `x` from the activations of the layers before it.
    pub(super) fn forward(&self, net: Context<'_>, l: usize, x: &mut Activations) {
        let Context { arch, shape, .. } = net;
        let (w, heads, hidden) = (shape.width, shape.n_heads, shape.gat.mlp_hidden);
        let n = x.n;
        let rows = n * 16;
        let (before, y) = x.split(l);
        let Self { forward, spans, fold, .. } = self;
        let bias = |linear: &Linear| Base::Bias(net.of(&linear.b));
        let norm = |[scale, offset]: &Norm| [net.of(scale), net.of(offset)];
        y.resize(n, w, heads, hidden, fold.n_in, shape.sizes.edge);

        product(arch, before.input, &forward.to_node, Base::Zero, false, &mut y.compare_nodes);
        product(arch, before.input, &forward.to_edge, Base::Zero, false, &mut y.compare_edges);
        let graphs = before.graphs(shape, fold.n_in, [&y.compare_nodes, &y.compare_edges]);
        arch.dispatch(Attend { graphs, weights: &mut y.weights, means: [&mut y.mean_nodes, &mut y.mean_edges] });
        let mut residual = vec![0.0; rows * w];
        product(arch, &y.mean_nodes, &forward.from_nodes, Base::Bias(&fold.matrices.constant), false, &mut residual);
        product(arch, &y.mean_edges, &forward.from_edges, Base::Kept, false, &mut residual);
        layer_norm(arch, [before.nodes, &residual], norm(&spans.ln_attn), &mut y.ln_attn, &mut y.attended);

        let mut shared = vec![0.0; n * hidden];
        product(arch, before.global, &forward.mlp_node[1], bias(&spans.mlp_node[0]), false, &mut shared);
        product(arch, &y.attended, &forward.mlp_node[0], Base::PerGraph(&shared), true, &mut y.hidden);
        product(arch, &y.hidden, &forward.mlp_node_out, bias(&spans.mlp_node[1]), false, &mut residual);
        layer_norm(arch, [&y.attended, &residual], norm(&spans.ln_mlp), &mut y.ln_mlp, &mut y.nodes);

        let mut sums = vec![0.0; n * w];
        sum_nodes(arch, &y.nodes, w, &mut sums);
        let inputs = before.global.chunks_exact(w).zip(sums.chunks_exact(w));
        for (to, (global, sum)) in y.global_input.chunks_exact_mut(2 * w).zip(inputs) {
            to[..w].copy_from_slice(global);
            to[w..].copy_from_slice(sum);
        }
        product(arch, &y.global_input, &forward.mlp_global[0], bias(&spans.mlp_global[0]), true, &mut y.global_hidden);
        product(arch, &y.global_hidden, &forward.mlp_global[1], bias(&spans.mlp_global[1]), false, &mut sums);
        layer_norm(arch, [before.global, &sums], norm(&spans.ln_global), &mut y.ln_global, &mut y.global);
    }

    /// Turns the gradient of this layer's output into that of its input, and adds the gradients of its parameters.
    pub(super) fn backward(
        &self,
        net: Context<'_>,
        l: usize,
        x: &mut Activations,
        flow: &mut Flow,
        folded: &mut Matrices,
        gradient: &mut [f32],
    ) {
        let Context { arch, shape, .. } = net;
        let (w, heads, hidden, ed) = (shape.width, shape.n_heads, shape.gat.mlp_hidden, shape.sizes.edge);
        let n = x.n;
        let rows = n * 16;
        let (before, y) = x.split(l);
        let spans = &self.spans;
        let back = self.backward.as_ref().expect("the network was made for gradients");

        // Global MLP.
        let Flow { nodes, global, hidden: of_hidden, shared, global_hidden, global_input, means, compare } = flow;
        let norm = gradient.get_disjoint_mut(spans.ln_global.clone()).expect("parameters lie apart");
        layer_norm_backward(arch, &y.ln_global, net.of(&spans.ln_global[0]), global, norm);
        let [first, second] = &spans.mlp_global;
        add_rows(arch, global, &mut gradient[second.b.clone()]);
        add_transposed(arch, &y.global_hidden, hidden, global, w, &mut gradient[second.w.clone()]);
        global_hidden.resize(n * hidden, 0.0);
        product(arch, global, &back.mlp_global[1], Base::Zero, false, global_hidden);
        relu_backward(arch, &y.global_hidden, global_hidden);
        add_rows(arch, global_hidden, &mut gradient[first.b.clone()]);
        add_transposed(arch, &y.global_input, 2 * w, global_hidden, hidden, &mut gradient[first.w.clone()]);
        global_input.resize(n * 2 * w, 0.0);
        product(arch, global_hidden, &back.mlp_global[0], Base::Zero, false, global_input);
        let mut sums = vec![0.0; n * w];
        let parts = global.chunks_exact_mut(w).zip(sums.chunks_exact_mut(w));
        for (input, (global, sum)) in global_input.chunks_exact(2 * w).zip(parts) {
            global.iter_mut().zip(input).for_each(|(g, input)| *g += input);
            sum.copy_from_slice(&input[w..]);
        }
        add_to_nodes(arch, &sums, w, nodes);

        // Node MLP.
        let norm = gradient.get_disjoint_mut(spans.ln_mlp.clone()).expect("parameters lie apart");
        layer_norm_backward(arch, &y.ln_mlp, net.of(&spans.ln_mlp[0]), nodes, norm);
        let [first, second] = &spans.mlp_node;
        add_rows(arch, nodes, &mut gradient[second.b.clone()]);
        add_transposed(arch, &y.hidden, hidden, nodes, w, &mut gradient[second.w.clone()]);
        of_hidden.resize(rows * hidden, 0.0);
        product(arch, nodes, &back.mlp_node_out, Base::Zero, false, of_hidden);
        relu_backward(arch, &y.hidden, of_hidden);
        shared.resize(n * hidden, 0.0);
        sum_nodes(arch, of_hidden, hidden, shared);
        add_rows(arch, shared, &mut gradient[first.b.clone()]);
        let (on_node, on_graph) = gradient[first.w.clone()].split_at_mut(w * hidden);
        add_transposed(arch, &y.attended, w, of_hidden, hidden, on_node);
        add_transposed(arch, before.global, w, shared, hidden, on_graph);
        product(arch, shared, &back.mlp_node[1], Base::Kept, false, global);
        product(arch, of_hidden, &back.mlp_node[0], Base::Kept, false, nodes);

        // Attention. Its residual connection passes the nodes' gradient through unchanged.
        let norm = gradient.get_disjoint_mut(spans.ln_attn.clone()).expect("parameters lie apart");
        layer_norm_backward(arch, &y.ln_attn, net.of(&spans.ln_attn[0]), nodes, norm);
        let n_in = self.fold.n_in;
        add_rows(arch, nodes, &mut folded.constant);
        add_transposed(arch, &y.mean_nodes, heads * n_in, nodes, w, &mut folded.from_nodes);
        add_transposed(arch, &y.mean_edges, heads * ed, nodes, w, &mut folded.from_edges);
        for (part, (kernel, each)) in [(&back.from_nodes, n_in), (&back.from_edges, ed)].into_iter().enumerate() {
            means[part].resize(rows * heads * each, 0.0);
            compare[part].resize(rows * heads * each, 0.0);
            product(arch, nodes, kernel, Base::Zero, false, &mut means[part]);
        }
        let graphs = before.graphs(shape, n_in, [&y.compare_nodes, &y.compare_edges]);
        let [of_nodes, of_edges] = compare;
        // Raw features have no gradient.
        let is_raw = self.fold.is_raw;
        arch.dispatch(AttendBackward {
            graphs,
            weights: &y.weights,
            means: means.each_ref().map(Vec::as_slice),
            compare: [of_nodes, of_edges],
            nodes: (!is_raw).then_some(&mut nodes[..]),
        });
        add_transposed(arch, before.input, n_in, of_nodes, heads * n_in, &mut folded.to_node);
        add_transposed(arch, before.input, n_in, of_edges, heads * ed, &mut folded.to_edge);
        if !is_raw {
            product(arch, of_nodes, &back.to_node, Base::Kept, false, nodes);
            product(arch, of_edges, &back.to_edge, Base::Kept, false, nodes);
        }
    }
}

/// The input of a layer.
pub(super) struct Before<'a> {
    /// The vectors attended to: raw features in the first layer if that is cheaper.
    input: &'a [f32],
    /// `[rows, w]` and `[b, w]`
    nodes: &'a [f32],
    global: &'a [f32],
    edges: &'a [f32],
    edges_t: &'a [f32],
}

impl<'a> Before<'a> {
    /// Returns the input of the attention, with vectors of length `n` for the nodes.
    fn graphs(&self, shape: &Shape, n: usize, [compare_nodes, compare_edges]: [&'a [f32]; 2]) -> Graphs<'a> {
        let Self { input: nodes, edges, edges_t, .. } = *self;
        Graphs { n_heads: shape.n_heads, n, ed: shape.sizes.edge, nodes, edges, edges_t, compare_nodes, compare_edges }
    }
}

impl Activations {
    /// Returns the input of layer `l` and the activations that it writes.
    fn split(&mut self, l: usize) -> (Before<'_>, &mut LayerActivations) {
        let Self { raw, is_raw, edges, edges_t, embedded, embedded_global, layers, .. } = self;
        let (before, from) = layers.split_at_mut(l);
        let (nodes, global) =
            before.last().map_or((&embedded[..], &embedded_global[..]), |layer| (&layer.nodes[..], &layer.global[..]));
        let input = if l == 0 && *is_raw { &raw[..] } else { nodes };
        (Before { input, nodes, global, edges, edges_t }, &mut from[0])
    }
}

impl LayerActivations {
    fn resize(&mut self, n: usize, w: usize, heads: usize, hidden: usize, n_in: usize, ed: usize) {
        let rows = 16 * n;
        for (values, len) in [
            (&mut self.compare_nodes, rows * heads * n_in),
            (&mut self.compare_edges, rows * heads * ed),
            (&mut self.weights, rows * heads * 16),
            (&mut self.mean_nodes, rows * heads * n_in),
            (&mut self.mean_edges, rows * heads * ed),
            (&mut self.attended, rows * w),
            (&mut self.hidden, rows * hidden),
            (&mut self.nodes, rows * w),
            (&mut self.global_input, n * 2 * w),
            (&mut self.global_hidden, n * hidden),
            (&mut self.global, n * w),
        ] {
            values.resize(len, 0.0);
        }
    }
}

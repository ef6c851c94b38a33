//! The policy head and the value head (paper, sections "Policy" and "Critic" and the listing).

use blueprints::N_BLOCKS as N;

use super::activations::Activations;
use super::fold::columns;
use super::layer::Flow;
use super::matmul::{Base, Packed, add_transposed, product, product_of};
use super::ops::{add, add_rows, dot, relu_backward, softmax};
use super::spans::{Context, Linear, Shape};
use crate::config::MIN_STD;

/// Network output for B scenes with G grippers; see [`crate::NetworkOutput`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outputs {
    /// Means of the moves `[B, 16, 6]`; empty for the mixture head.
    pub locs: Vec<f32>,
    /// Standard deviations of the moves `[B, 16, 6]`; empty for the mixture head.
    pub scales: Vec<f32>,
    /// Logits of each gripper's choice `[B, G, 16]`, not masked.
    pub logits: Vec<f32>,
    /// Values `[B]`.
    pub values: Vec<f32>,
    /// Read-outs of the mixture head `[B, 16, N_READOUTS]`; empty for the Gaussian head.
    pub readouts: Vec<f32>,
}

/// Kernels of the policy head, or their transposes.
#[derive(Clone, Debug)]
pub(super) struct PolicyKernels {
    /// Of means and deviations; `None` for the mixture head.
    act: Option<[Packed; 2]>,
    input_global: Packed,
    grip_key: Packed,
    /// The rows of the block key kernel that act on nodes.
    block_key: Packed,
    proposals: Option<Packed>,
}

/// Kernels of the value head, or their transposes.
#[derive(Clone, Debug)]
pub(super) struct ValueKernels {
    input_global: Packed,
    graph_global: Packed,
    mlp: Vec<Packed>,
}

/// Inputs and hidden units of the value MLP for a whole batch.
#[derive(Clone, Debug, Default)]
pub(super) struct ValueActivations {
    /// `[B, gd]` and `[B, w]`
    pub(super) raw_global: Vec<f32>,
    pub(super) global: Vec<f32>,
    /// The input of each layer.
    inputs: Vec<Vec<f32>>,
}

impl PolicyKernels {
    pub(super) fn new(net: Context<'_>, pack: impl Fn(&[f32], [usize; 2]) -> Packed) -> Self {
        let Context { shape, spans, .. } = net;
        let (w, g) = (shape.width, shape.sizes.n_grippers);
        let linear = |linear: &Linear| pack(net.of(&linear.w), [w, linear.n_out]);
        Self {
            act: spans.act.as_ref().map(|act| act.each_ref().map(linear)),
            input_global: pack(net.of(&spans.input_global), [shape.sizes.global, w]),
            grip_key: pack(net.of(&spans.grip_key), [2 * w, g * w]),
            block_key: pack(&net.of(&spans.block_key)[..w * w], [w, w]),
            proposals: spans.proposals.as_ref().map(linear),
        }
    }

    /// Appends the outputs computed from the last layer's nodes and globals.
    pub(super) fn forward(&self, net: Context<'_>, x: &mut Activations, out: &mut Outputs) {
        let Context { arch, shape, spans, .. } = net;
        let (w, g) = (shape.width, shape.sizes.n_grippers);
        let rows = x.n * N;
        let (nodes, global) = x.layers.last().map_or((&x.embedded, &x.embedded_global), |l| (&l.nodes, &l.global));
        let n_before = out.scales.len();
        let act = spans.act.iter().flatten().zip(self.act.iter().flatten()).zip([&mut out.locs, &mut out.scales]);
        let proposals = spans.proposals.iter().zip(&self.proposals).zip([&mut out.readouts]);
        for ((linear, kernel), to) in act.chain(proposals) {
            let at = to.len();
            to.resize(at + rows * linear.n_out, 0.0);
            product(arch, nodes, kernel, Base::Bias(net.of(&linear.b)), false, &mut to[at..]);
        }
        out.scales[n_before..].iter_mut().for_each(|s| *s = scale(shape.std_offset, *s));

        let own = product_of(arch, &x.raw_global, &self.input_global);
        x.grip_input.clear();
        for (own, global) in own.chunks_exact(w).zip(global.chunks_exact(w)) {
            x.grip_input.extend_from_slice(own);
            x.grip_input.extend_from_slice(global);
        }
        x.grip.resize(x.n * g * w, 0.0);
        product(arch, &x.grip_input, &self.grip_key, Base::Zero, false, &mut x.grip);
        x.block_keys.resize(rows * w, 0.0);
        product(arch, nodes, &self.block_key, Base::Zero, false, &mut x.block_keys);
        let of_held = &net.of(&spans.block_key)[w * w..];
        let keys = x.block_keys.chunks_exact_mut(N * w);
        for ((keys, grips), raw) in
            keys.zip(x.grip.chunks_exact(g * w)).zip(x.raw_global.chunks_exact(shape.sizes.global))
        {
            for (gripper, row) in of_held.chunks_exact(w).enumerate() {
                for (key, &bit) in keys.chunks_exact_mut(w).zip(held(shape, raw, gripper)) {
                    if bit != 0.0 {
                        key.iter_mut().zip(row).for_each(|(key, row)| *key += bit * row);
                    }
                }
            }
            for grip in grips.chunks_exact(w) {
                out.logits.extend(keys.chunks_exact(w).map(|key| dot(key, grip) / (w as f32).sqrt()));
            }
        }
    }

    /// Sets the gradient of the last layer's nodes and adds to that of its globals; `self` holds the transposes. The
    /// input gradients are those of these scenes' means, unbounded deviations, logits, and read-outs.
    pub(super) fn backward(
        &self,
        net: Context<'_>,
        x: &Activations,
        [locs, scales, logits, readouts]: [&[f32]; 4],
        flow: &mut Flow,
        gradient: &mut [f32],
    ) {
        let Context { arch, shape, spans, .. } = net;
        let (w, g) = (shape.width, shape.sizes.n_grippers);
        let rows = x.n * N;
        let nodes = x.layers.last().map_or(&x.embedded, |layer| &layer.nodes);
        flow.nodes.resize(rows * w, 0.0);
        let act = spans.act.iter().flatten().zip(self.act.iter().flatten()).zip([locs, scales]);
        let proposals = spans.proposals.iter().zip(&self.proposals).zip([readouts]);
        let mut base = Base::Zero;
        for ((linear, kernel), by_output) in act.chain(proposals) {
            add_rows(arch, by_output, &mut gradient[linear.b.clone()]);
            add_transposed(arch, nodes, w, by_output, linear.n_out, &mut gradient[linear.w.clone()]);
            product(arch, by_output, kernel, base, false, &mut flow.nodes);
            base = Base::Kept;
        }

        let mut of_grip = vec![0.0; x.n * g * w];
        let mut of_keys = vec![0.0; rows * w];
        let per_root = 1.0 / (w as f32).sqrt();
        let (on_nodes, on_held) = gradient[spans.block_key.clone()].split_at_mut(w * w);
        let scenes = of_keys.chunks_exact_mut(N * w).zip(of_grip.chunks_exact_mut(g * w)).enumerate();
        for (scene, (of_keys, of_grip)) in scenes {
            let keys = &x.block_keys[scene * N * w..(scene + 1) * N * w];
            let raw = &x.raw_global[scene * shape.sizes.global..][..shape.sizes.global];
            for (gripper, of_grip) in of_grip.chunks_exact_mut(w).enumerate() {
                let grip = &x.grip[(scene * g + gripper) * w..][..w];
                let logits = &logits[(scene * g + gripper) * N..][..N];
                let blocks = of_keys.chunks_exact_mut(w).zip(keys.chunks_exact(w));
                for ((of_key, key), logit) in blocks.zip(logits) {
                    let d = logit * per_root;
                    of_key.iter_mut().zip(grip).for_each(|(to, grip)| *to += d * grip);
                    of_grip.iter_mut().zip(key).for_each(|(to, key)| *to += d * key);
                }
            }
            for (gripper, row) in on_held.chunks_exact_mut(w).enumerate() {
                for (of_key, &bit) in of_keys.chunks_exact(w).zip(held(shape, raw, gripper)) {
                    if bit != 0.0 {
                        row.iter_mut().zip(of_key).for_each(|(to, g)| *to += bit * g);
                    }
                }
            }
        }
        add_transposed(arch, nodes, w, &of_keys, w, on_nodes);
        product(arch, &of_keys, &self.block_key, Base::Kept, false, &mut flow.nodes);
        add_transposed(arch, &x.grip_input, 2 * w, &of_grip, g * w, &mut gradient[spans.grip_key.clone()]);
        let of_input = product_of(arch, &of_grip, &self.grip_key);
        let own = columns(&of_input, 2 * w, 0, w);
        add_transposed(arch, &x.raw_global, shape.sizes.global, &own, w, &mut gradient[spans.input_global.clone()]);
        for (global, input) in flow.global.chunks_exact_mut(w).zip(of_input.chunks_exact(2 * w)) {
            add(arch, &input[w..], global);
        }
    }
}

impl ValueKernels {
    pub(super) fn new(net: Context<'_>, pack: impl Fn(&[f32], [usize; 2]) -> Packed) -> Self {
        let Context { shape, spans, .. } = net;
        let w = shape.width;
        let mlp = |linear: &Linear| pack(net.of(&linear.w), [linear.w.len() / linear.n_out, linear.n_out]);
        Self {
            input_global: pack(net.of(&spans.value_input_global), [shape.sizes.global, w]),
            graph_global: pack(net.of(&spans.value_graph_global), [w, w]),
            mlp: spans.value_mlp.iter().map(mlp).collect(),
        }
    }

    /// Computes the values of all scenes; reads the choices from the logits.
    pub(super) fn forward(&self, net: Context<'_>, x: &mut ValueActivations, out: &mut Outputs) {
        let Context { arch, shape, spans, .. } = net;
        let w = shape.width;
        let n_choices = shape.sizes.n_grippers * N;
        let n = out.logits.len() / n_choices;
        let own = product_of(arch, &x.raw_global, &self.input_global);
        let graph = product_of(arch, &x.global, &self.graph_global);
        x.inputs.resize_with(self.mlp.len(), Vec::new);
        let first = &mut x.inputs[0];
        first.clear();
        for ((own, graph), logits) in own.chunks_exact(w).zip(graph.chunks_exact(w)).zip(out.logits.chunks(n_choices)) {
            first.extend_from_slice(own);
            first.extend_from_slice(graph);
            for logits in logits.as_chunks::<N>().0 {
                let mut choice = *logits;
                softmax(&mut choice, None);
                first.extend(choice);
            }
        }
        out.values.resize(n, 0.0);
        for (j, (linear, kernel)) in spans.value_mlp.iter().zip(&self.mlp).enumerate() {
            let bias = Base::Bias(net.of(&linear.b));
            let (inputs, next) = x.inputs.split_at_mut(j + 1);
            match next.first_mut() {
                Some(next) => {
                    next.resize(n * linear.n_out, 0.0);
                    product(arch, &inputs[j], kernel, bias, true, next);
                }
                None => product(arch, &inputs[j], kernel, bias, false, &mut out.values),
            }
        }
    }

    /// Returns the gradient of the globals, `[B, w]`; `self` holds the transposes. No gradient flows into the choices
    /// (listing).
    pub(super) fn backward(
        &self,
        net: Context<'_>,
        x: &ValueActivations,
        values: &[f32],
        gradient: &mut [f32],
    ) -> Vec<f32> {
        let Context { arch, shape, spans, .. } = net;
        let (w, gd) = (shape.width, shape.sizes.global);
        let mut flow = values.to_vec();
        for (j, (linear, kernel)) in spans.value_mlp.iter().zip(&self.mlp).enumerate().rev() {
            let n_in = linear.w.len() / linear.n_out;
            add_rows(arch, &flow, &mut gradient[linear.b.clone()]);
            add_transposed(arch, &x.inputs[j], n_in, &flow, linear.n_out, &mut gradient[linear.w.clone()]);
            let mut before = product_of(arch, &flow, kernel);
            if j > 0 {
                relu_backward(arch, &x.inputs[j], &mut before);
            }
            flow = before;
        }
        let n_in = flow.len() / values.len();
        let [own, graph] = [0, w].map(|first| columns(&flow, n_in, first, w));
        add_transposed(arch, &x.raw_global, gd, &own, w, &mut gradient[spans.value_input_global.clone()]);
        add_transposed(arch, &x.global, w, &graph, w, &mut gradient[spans.value_graph_global.clone()]);
        product_of(arch, &graph, &self.graph_global)
    }
}

/// Maps the head's output to a standard deviation, `softplus(x + offset)` plus the smallest one.
fn scale(offset: f32, x: f32) -> f32 {
    let x = x + offset;
    x.max(0.0) + (-x.abs()).exp().ln_1p() + MIN_STD
}

/// Computes the gradient of the numbers from which the deviations were computed.
pub(super) fn unscale(deviations: &[f32], gradient: &[f32]) -> Vec<f32> {
    // softplus' = sigmoid = 1 − e^−softplus.
    let slope = |deviation: f32| -(-(deviation - MIN_STD)).exp_m1();
    deviations.iter().zip(gradient).map(|(&deviation, g)| if *g == 0.0 { 0.0 } else { g * slope(deviation) }).collect()
}

/// Returns the one-hot of the block that a gripper held: the last 16 entries of its part of the raw globals.
fn held<'a>(shape: &Shape, raw: &'a [f32], gripper: usize) -> &'a [f32] {
    let part = raw.len() / shape.sizes.n_grippers;
    &raw[(gripper + 1) * part - N..(gripper + 1) * part]
}

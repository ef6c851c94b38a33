//! The graph network on the CPU, with handwritten forward and backward passes.
//!
//! Computes the same numbers as [`crate::Network`] on burn, which its tests use as the oracle, and which runs on GPUs
//! and for the non-graph baseline. Here, large buffers are reused between passes, a few graphs at a time stay in the
//! cache, and the first layer attends to raw features.
//!
//! Reading order: `matmul` and `ops` (building blocks) → `spans` (positions of the parameters) → `fold` → `attend` →
//! `layer` → `heads`.

mod activations;
mod attend;
mod fold;
mod heads;
mod layer;
mod matmul;
mod ops;
mod spans;

use pulp::Arch;

pub use heads::Outputs;

use self::activations::{Activations, GRAPHS};
use self::fold::Matrices;
use self::heads::{PolicyKernels, ValueActivations, ValueKernels, unscale};
use self::layer::{Flow, Layer};
use self::matmul::{Base, Packed, add_transposed, product};
use self::ops::add_rows;
use self::spans::{Context, Shape, Spans};
use crate::config::NetworkConfig;
use crate::features::FeatureSizes;
use crate::parameters::{ParameterError, ParameterSpec};
use crate::{FeatureBatch, parameters};

/// A graph network with parameters, ready to compute.
#[derive(Clone, Debug)]
pub struct CpuNetwork {
    arch: Arch,
    shape: Shape,
    spans: Spans,
    parameters: Vec<f32>,
    embed_node: Packed,
    embed_global: Packed,
    layers: Vec<Layer>,
    policy: PolicyKernels,
    value: ValueKernels,
    /// Transposes of the heads' kernels, if gradients are needed.
    backward: Option<(PolicyKernels, ValueKernels)>,
}

/// Intermediate results of a forward pass for the backward pass; the memory is reused between passes.
#[derive(Clone, Debug, Default)]
pub struct Tape {
    parts: Vec<Activations>,
    n_parts: usize,
    value: ValueActivations,
    flow: Flow,
    /// Gradients of the folded matrices of each layer.
    folded: Vec<Matrices>,
    outputs: Outputs,
}

impl Tape {
    /// Returns the outputs of the last forward pass.
    pub fn outputs(&self) -> &Outputs {
        &self.outputs
    }

    /// Returns the edge weights of each layer in the last forward pass, `[n, 16 receivers, heads, 16 senders]`. Without
    /// attention, they are equal, with one head.
    pub fn attention(&self) -> Vec<Vec<f32>> {
        let parts = &self.parts[..self.n_parts];
        let n_layers = parts.first().map_or(0, |part| part.layers.len());
        let layer = |l: usize| parts.iter().flat_map(move |part| part.layers[l].weights.iter().copied()).collect();
        (0..n_layers).map(layer).collect()
    }
}

impl CpuNetwork {
    /// Creates a network with `parameters`. Without `with_gradients`, it can only run forward and takes less time to
    /// create.
    ///
    /// # Errors
    /// If the number of parameters is wrong or one is not finite.
    pub fn new(network: &NetworkLayout, parameters: &[f32], with_gradients: bool) -> Result<Self, ParameterError> {
        let NetworkLayout { shape, spans } = network.clone();
        parameters::check(parameters, spans.n_parameters)?;
        let arch = Arch::new();
        let net = Context { arch, shape: &shape, spans: &spans, parameters };
        let heads =
            |pack: fn(&[f32], [usize; 2]) -> Packed| (PolicyKernels::new(net, pack), ValueKernels::new(net, pack));
        let (policy, value) = heads(Packed::new);
        Ok(Self {
            embed_node: Packed::new(net.of(&spans.embed_node), [shape.sizes.node + 1, shape.width]),
            embed_global: Packed::new(net.of(&spans.embed_global.w), [shape.sizes.global, shape.width]),
            layers: (0..shape.gat.n_layers).map(|l| Layer::new(net, l, with_gradients)).collect(),
            backward: with_gradients.then(|| heads(Packed::transposed)),
            policy,
            value,
            arch,
            parameters: parameters.to_vec(),
            shape,
            spans,
        })
    }

    /// Whether its layers use attention instead of averaging.
    pub fn attends(&self) -> bool {
        self.shape.gat.attention
    }

    /// Returns the parameters as a flat vector.
    pub fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// Computes the outputs for `rows` of a batch of normalized features, and keeps what the backward pass needs.
    ///
    /// # Panics
    /// If a row is not in the batch, or the batch has other feature sizes.
    pub fn forward<'t>(&self, batch: &FeatureBatch, rows: &[usize], tape: &'t mut Tape) -> &'t Outputs {
        tape.n_parts = rows.len().div_ceil(GRAPHS);
        tape.parts.resize_with(tape.parts.len().max(tape.n_parts), Activations::default);
        self.run(batch, rows, tape)
    }

    /// Like [`CpuNetwork::forward`], but without support for a backward pass: all graphs use the same memory.
    ///
    /// # Panics
    /// As for [`CpuNetwork::forward`].
    pub fn infer<'t>(&self, batch: &FeatureBatch, rows: &[usize], tape: &'t mut Tape) -> &'t Outputs {
        tape.n_parts = 0;
        tape.parts.resize_with(tape.parts.len().max(1), Activations::default);
        self.run(batch, rows, tape)
    }

    fn run<'t>(&self, batch: &FeatureBatch, rows: &[usize], tape: &'t mut Tape) -> &'t Outputs {
        assert_eq!(batch.sizes, self.shape.sizes, "features of this network");
        let Tape { parts, n_parts, value, outputs, .. } = tape;
        let Outputs { locs, scales, logits, values, readouts } = outputs;
        [locs, scales, logits, values, readouts].into_iter().for_each(Vec::clear);
        value.raw_global.clear();
        value.global.clear();
        for (part, rows) in rows.chunks(GRAPHS).enumerate() {
            let x = &mut parts[if *n_parts == 0 { 0 } else { part }];
            x.read(&self.shape, batch, rows);
            self.encode(x);
            self.policy.forward(self.context(), x, outputs);
            value.raw_global.extend_from_slice(&x.raw_global);
            value.global.extend_from_slice(x.layers.last().map_or(&x.embedded_global, |layer| &layer.global));
        }
        self.value.forward(self.context(), value, outputs);
        outputs
    }

    fn context(&self) -> Context<'_> {
        Context { arch: self.arch, shape: &self.shape, spans: &self.spans, parameters: &self.parameters }
    }

    fn encode(&self, x: &mut Activations) {
        let net = self.context();
        let (arch, w) = (net.arch, net.shape.width);
        x.embedded.resize(x.n * 16 * w, 0.0);
        product(arch, &x.raw, &self.embed_node, Base::Zero, false, &mut x.embedded);
        x.embedded_global.resize(x.n * w, 0.0);
        let bias = Base::Bias(net.of(&self.spans.embed_global.b));
        product(arch, &x.raw_global, &self.embed_global, bias, false, &mut x.embedded_global);
        for (l, layer) in self.layers.iter().enumerate() {
            layer.forward(net, l, x);
        }
    }

    /// Computes the gradient of a loss from its gradient with respect to the outputs of the last forward pass on this
    /// tape. Overwrites `gradient`, in the order of the flat parameters; reusing the vector avoids allocating new
    /// memory pages.
    ///
    /// # Panics
    /// If the network was created without gradients, the last pass on the tape was not a [`CpuNetwork::forward`], or
    /// the lengths of `by_output` differ from its outputs.
    pub fn backward(&self, tape: &mut Tape, by_output: &Outputs, gradient: &mut Vec<f32>) {
        let net = self.context();
        let Context { arch, shape, spans, .. } = net;
        let (policy, value) = self.backward.as_ref().expect("the network was made for gradients");
        let Tape { parts, n_parts, value: of_value, flow, folded, outputs } = tape;
        let n_kept: usize = parts[..*n_parts].iter().map(|part| part.n).sum();
        assert_eq!(by_output.values.len(), n_kept, "gradients of the last forward pass");
        gradient.clear();
        gradient.resize(spans.n_parameters, 0.0);
        folded.resize_with(self.layers.len(), Matrices::default);
        self.layers.iter().zip(&mut *folded).for_each(|(layer, folded)| layer.fold.clear(folded));
        let global = value.backward(net, of_value, &by_output.values, gradient);
        let scales = unscale(&outputs.scales, &by_output.scales);
        let n_readouts = spans.proposals.as_ref().map_or(0, |linear| linear.n_out);
        let n_moves = if spans.act.is_some() { 6 } else { 0 };
        let mut done = 0;
        for (x, global) in parts[..*n_parts].iter_mut().zip(global.chunks(GRAPHS * shape.width)) {
            let rows = |per_block: usize| done * 16 * per_block..(done + x.n) * 16 * per_block;
            let by_head = [
                &by_output.locs[rows(n_moves)],
                &scales[rows(n_moves)],
                &by_output.logits[rows(shape.sizes.n_grippers)],
                &by_output.readouts[rows(n_readouts)],
            ];
            done += x.n;
            flow.global.clear();
            flow.global.extend_from_slice(global);
            policy.backward(net, x, by_head, flow, gradient);
            for (l, (layer, folded)) in self.layers.iter().zip(&mut *folded).enumerate().rev() {
                layer.backward(net, l, x, flow, folded, gradient);
            }
            let (w, nd, gd) = (shape.width, shape.sizes.node, shape.sizes.global);
            add_transposed(arch, &x.raw, nd + 1, &flow.nodes, w, &mut gradient[spans.embed_node.clone()]);
            let of_global = &spans.embed_global;
            add_rows(arch, &flow.global, &mut gradient[of_global.b.clone()]);
            add_transposed(arch, &x.raw_global, gd, &flow.global, w, &mut gradient[of_global.w.clone()]);
        }
        for (l, (layer, folded)) in self.layers.iter().zip(folded).enumerate() {
            layer.fold.unfold(net, l, folded, gradient);
        }
    }
}

/// Layout of a network: everything that [`CpuNetwork`] needs except the parameters.
#[derive(Clone, Debug)]
pub struct NetworkLayout {
    shape: Shape,
    spans: Spans,
}

impl NetworkLayout {
    /// Creates the layout for a configuration whose parameters are listed in `table`; `None` if the encoder is not the
    /// graph encoder.
    pub fn new(config: &NetworkConfig, sizes: &FeatureSizes, table: &[ParameterSpec]) -> Option<Self> {
        let shape = Shape::new(config, sizes)?;
        let spans = Spans::new(&shape, table);
        Some(Self { shape, spans })
    }
}

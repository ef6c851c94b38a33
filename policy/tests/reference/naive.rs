//! The folded graph encoder against the listing's unfolded form, which encodes, queries, and projects every edge.
//!
//! The oracle is plain `f64` arithmetic over the flat parameters. The sizes differ from the paper's, so that no two are
//! equal by coincidence.

use std::cell::RefCell;
use std::collections::BTreeMap;

use crate::common::{TOLERANCE, generate, relative_error};
use burn::tensor::Device;
use policy::cpu::{CpuNetwork, NetworkLayout, Outputs, Tape};
use policy::features::N_EDGES;
use policy::parameters;
use policy::{
    BatchTensors, EncoderConfig, FeatureBatch, FeatureConfig, FeatureSizes, GatConfig, MoveHead, Network, NetworkConfig,
};

const N: usize = 16;

/// A kernel `[n_in, n_out]`, row-major.
struct Matrix {
    values: Vec<f64>,
    n_in: usize,
    n_out: usize,
}

impl Matrix {
    fn apply(&self, x: &[f64]) -> Vec<f64> {
        assert_eq!(x.len(), self.n_in);
        (0..self.n_out).map(|o| x.iter().enumerate().map(|(i, x)| x * self.values[i * self.n_out + o]).sum()).collect()
    }
}

struct Oracle {
    parameters: BTreeMap<String, Matrix>,
    gat: GatConfig,
    grippers: usize,
    value_layers: usize,
    /// Attention weights of the senders, by layer, receiver, and head.
    seen: RefCell<BTreeMap<(String, usize, usize), [f64; N]>>,
}

impl Oracle {
    fn project(&self, name: &str, x: &[f64]) -> Vec<f64> {
        self.parameters[&format!("{name}.w")].apply(x)
    }

    fn linear(&self, name: &str, x: &[f64]) -> Vec<f64> {
        let bias = &self.parameters[&format!("{name}.b")].values;
        self.project(name, x).iter().zip(bias).map(|(y, b)| y + b).collect()
    }

    fn layer_norm(&self, name: &str, x: &[f64]) -> Vec<f64> {
        let n = x.len() as f64;
        let mean = x.iter().sum::<f64>() / n;
        let variance = x.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
        let scale = &self.parameters[&format!("{name}.scale")].values;
        let offset = &self.parameters[&format!("{name}.offset")].values;
        (0..x.len()).map(|k| (x[k] - mean) / (variance + 1e-5).sqrt() * scale[k] + offset[k]).collect()
    }

    fn mlp(&self, name: &str, x: &[f64]) -> Vec<f64> {
        self.linear(&format!("{name}.1"), &relu(&self.linear(&format!("{name}.0"), x)))
    }

    fn node_update(
        &self,
        layer: &str,
        nodes: &[Vec<f64>],
        edges: &BTreeMap<(usize, usize), Vec<f64>>,
        r: usize,
    ) -> Vec<f64> {
        let (heads, dim) = (self.gat.n_heads, self.gat.head_dim);
        let senders: Vec<usize> = (0..N).filter(|s| edges.contains_key(&(*s, r))).collect();
        let input = |s: usize| [nodes[s].as_slice(), &edges[&(s, r)]].concat();
        let mut gathered = vec![0.0; heads * dim];
        for h in 0..heads {
            let part = h * dim..(h + 1) * dim;
            let logits: Vec<f64> = senders
                .iter()
                .map(|s| {
                    if !self.gat.attention {
                        return 0.0;
                    }
                    let query = self.project(&format!("{layer}.query"), &input(*s));
                    let key = self.project(&format!("{layer}.key"), &nodes[r]);
                    part.clone().map(|k| query[k] * key[k]).sum::<f64>() / (dim as f64).sqrt()
                })
                .collect();
            let mut row = [0.0; N];
            for (s, weight) in senders.iter().zip(softmax(&logits)) {
                row[*s] = weight;
                let message = self.project(&format!("{layer}.message"), &input(*s));
                part.clone().for_each(|k| gathered[k] += weight * message[k]);
            }
            self.seen.borrow_mut().insert((layer.to_owned(), r, h), row);
        }
        add(&nodes[r], &self.project(&format!("{layer}.node_proj"), &gathered))
    }

    /// Returns means, standard deviations, logits, and value of one scene.
    fn run(&self, nodes: &[Vec<f64>], edges: &BTreeMap<(usize, usize), Vec<f64>>, raw: &[f64]) -> [Vec<f64>; 4] {
        let edges = edges.iter().map(|(k, e)| (*k, self.linear("embed_edge", e))).collect();
        let mut nodes: Vec<_> = nodes.iter().map(|n| self.linear("embed_node", n)).collect();
        let mut global = self.linear("embed_global", raw);
        for l in 0..self.gat.n_layers {
            let layer = format!("layer{l}");
            let update = |r: usize| {
                let y = self.layer_norm(&format!("{layer}.ln_attn"), &self.node_update(&layer, &nodes, &edges, r));
                let h = self.mlp(&format!("{layer}.mlp_node"), &[y.as_slice(), &global].concat());
                self.layer_norm(&format!("{layer}.ln_mlp"), &add(&h, &y))
            };
            nodes = (0..N).map(update).collect();
            let sum = nodes.iter().skip(1).fold(nodes[0].clone(), |a, b| add(&a, b));
            let h = self.mlp(&format!("{layer}.mlp_global"), &[global.as_slice(), &sum].concat());
            global = self.layer_norm(&format!("{layer}.ln_global"), &add(&h, &global));
        }
        let locs: Vec<f64> = nodes.iter().flat_map(|n| self.linear("head.act_loc", n)).collect();
        let scales =
            nodes.iter().flat_map(|n| self.linear("head.act_scale", n)).map(|x| x.exp().ln_1p() + 1e-6).collect();
        let logits = self.logits(&nodes, &global, raw);
        let choice: Vec<f64> = logits.chunks(N).flat_map(softmax).collect();
        let own = self.project("value.input_global", raw);
        let mut x = [own, self.project("value.graph_global", &global), choice].concat();
        for j in 0..self.value_layers {
            x = self.linear(&format!("value.mlp.{j}"), &if j == 0 { x } else { relu(&x) });
        }
        [locs, scales, logits, x]
    }

    fn logits(&self, nodes: &[Vec<f64>], global: &[f64], raw: &[f64]) -> Vec<f64> {
        let grip = self.project("head.grip_key", &[&self.project("head.input_global", raw), global].concat());
        let part = raw.len() / self.grippers;
        let width = global.len();
        let mut logits = Vec::new();
        for g in 0..self.grippers {
            for (b, node) in nodes.iter().enumerate() {
                let held: Vec<f64> = (0..self.grippers).map(|g| raw[(g + 1) * part - N + b]).collect();
                let key = self.project("head.block_key", &[node.as_slice(), &held].concat());
                let dot: f64 = (0..width).map(|k| grip[g * width + k] * key[k]).sum();
                logits.push(dot / (width as f64).sqrt());
            }
        }
        logits
    }
}

fn relu(x: &[f64]) -> Vec<f64> {
    x.iter().map(|v| v.max(0.0)).collect()
}

fn add(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a + b).collect()
}

fn softmax(x: &[f64]) -> Vec<f64> {
    let max = x.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let exp: Vec<f64> = x.iter().map(|v| (v - max).exp()).collect();
    let sum: f64 = exp.iter().sum();
    exp.iter().map(|v| v / sum).collect()
}

fn check(gat: GatConfig, n_grippers: usize) {
    let sizes = FeatureSizes { node: 5, edge: 7, global: n_grippers * 19, n_grippers };
    let config = NetworkConfig {
        encoder: EncoderConfig::Gat(gat),
        width: 12,
        value_hidden: vec![20, 9],
        init_std: None,
        move_head: MoveHead::Gaussian,
    };
    proto::setting::Section::validate_at(&config, "policy.network").unwrap();
    let device = Device::flex();
    let network = Network::init(&config, &sizes, 0, &device);
    let flat: Vec<f32> = generate("naive", 7, network.n_parameters()).iter().map(|x| (0.6 * x) as f32).collect();
    let network = parameters::load(network, &flat).unwrap();
    let mut named = BTreeMap::new();
    for (spec, span) in parameters::spans(network.table()) {
        let values = flat[span].iter().map(|x| f64::from(*x)).collect();
        named.insert(spec.name.clone(), Matrix { values, n_in: spec.shape[0], n_out: *spec.shape.last().unwrap() });
    }
    let oracle = Oracle { parameters: named, gat, grippers: n_grippers, value_layers: 3, seen: RefCell::default() };

    let input = |name: &str, n: usize| -> Vec<f32> { generate(name, 3, n).iter().map(|x| *x as f32).collect() };
    let nodes = input("n", N * sizes.node);
    let edges = input("e", N_EDGES * sizes.edge);
    let raw = input("g", sizes.global);
    let mut batch = FeatureBatch::new(&FeatureConfig::paper());
    (batch.n, batch.sizes) = (1, sizes);
    (batch.nodes, batch.edges, batch.globals) = (nodes.clone(), edges.clone(), raw.clone());
    let output = network.forward(&BatchTensors::new(&batch, &device));

    let wide = |x: &[f32]| -> Vec<f64> { x.iter().map(|v| f64::from(*v)).collect() };
    let pairs = (0..N).flat_map(|s| (0..N).filter(move |r| *r != s).map(move |r| (s, r)));
    let listed = pairs.zip(edges.chunks(sizes.edge).map(wide)).collect();
    let rows: Vec<_> = nodes.chunks(sizes.node).map(wide).collect();
    let expected = oracle.run(&rows, &listed, &wide(&raw));
    let Outputs { locs, scales, logits, values, .. } = output.into();
    let ours = [locs, scales, logits, values];
    for (name, (ours, expected)) in ["locs", "scales", "logits", "values"].iter().zip(ours.iter().zip(&expected)) {
        let error = relative_error(ours, expected);
        assert!(error <= TOLERANCE, "{name} is off by {error:e} with {gat:?} and {n_grippers} grippers");
    }
    let layout = NetworkLayout::new(&config, &sizes, network.table()).expect("a graph network");
    let mut tape = Tape::default();
    CpuNetwork::new(&layout, &flat, false).unwrap().forward(&batch, &[0], &mut tape);
    assert_eq!(tape.attention().len(), gat.n_layers);
    if !gat.attention {
        let equal = 1.0 / (N - 1) as f32;
        let is_equal = |i: usize, weight: f32| weight == if i / N == i % N { 0.0 } else { equal };
        for weights in tape.attention() {
            assert_eq!(weights.len(), N * N);
            assert!(weights.iter().enumerate().all(|(i, weight)| is_equal(i, *weight)), "{weights:?}");
        }
        return;
    }
    for (l, ours) in tape.attention().into_iter().enumerate() {
        assert_eq!(ours.len(), N * gat.n_heads * N);
        let rows = (0..N).flat_map(|r| (0..gat.n_heads).map(move |h| (format!("layer{l}"), r, h)));
        let expected: Vec<f64> = rows.flat_map(|row| oracle.seen.borrow()[&row]).collect();
        let error = relative_error(&ours, &expected);
        assert!(error <= TOLERANCE, "attention of layer {l} is off by {error:e} with {gat:?}");
        let is_self = |i: usize| i / (gat.n_heads * N) == i % N;
        assert!((0..ours.len()).filter(|i| is_self(*i)).all(|i| ours[i] == 0.0));
    }
}

#[test]
fn folded_equals_naive() {
    for attention in [true, false] {
        for n_grippers in [1, 2] {
            check(GatConfig { attention, n_layers: 2, n_heads: 3, head_dim: 8, mlp_hidden: 14 }, n_grippers);
        }
    }
}

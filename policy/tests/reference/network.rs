//! The network against vectors made with the paper's own listing in `f64` (JAX, Haiku, jraph).
//!
//! Outputs agree within 2e-5 of the largest entry of their tensor. For each gradient, the file has five numbers:
//! `first` and `last` agree within 2e-5 of its largest entry; `l2`, `sum`, and `dot` (with a fixed pseudo-random
//! vector) agree within 2e-5 of `l2`, times √n for `sum` and `dot`, which is the most that n such errors can add up to.
//! The value-only gradients have fewer of the five.

use std::collections::BTreeMap;
use std::path::Path;

use crate::common::{TOLERANCE, batch, generate, golden_path, numbers, read_json, relative_error, values, widened};
use burn::tensor::{Device, Tensor};
use policy::cpu::{CpuNetwork, NetworkLayout, Outputs, Tape};
use policy::features::N_EDGES;
use policy::parameters::{self, ParameterSpec};
use policy::{
    BatchTensors, EncoderConfig, FeatureBatch, FeatureSizes, GatConfig, MoveTensors, Network, NetworkConfig,
    NetworkOutput, ResnetConfig,
};
use serde_json::Value;

struct Golden {
    json: Value,
    seed: u64,
    batch: usize,
    sizes: FeatureSizes,
    config: NetworkConfig,
    tolerance: f64,
}

impl Golden {
    fn read(path: &Path, tolerance: f64) -> Self {
        let json = read_json(path);
        let info = &json["info"];
        let int = |key: &str| info[key].as_u64().unwrap() as usize;
        let sizes =
            FeatureSizes { node: int("node_dim"), edge: int("edge_dim"), global: int("global_dim"), n_grippers: 2 };
        let shapes = json["shapes"].as_object().unwrap();
        let layers =
            |prefix: &str, suffix: &str| shapes.keys().filter(|k| k.starts_with(prefix) && k.ends_with(suffix)).count();
        let encoder = match info["hidden"].as_u64() {
            Some(hidden) => EncoderConfig::Resnet(ResnetConfig {
                hidden: hidden as usize,
                n_blocks: layers("resnet.block", "fc0.w"),
            }),
            None => EncoderConfig::Gat(GatConfig {
                attention: shapes.contains_key("layer0.query.w"),
                n_layers: layers("layer", "message.w"),
                ..GatConfig::default()
            }),
        };
        let config = NetworkConfig { encoder, ..NetworkConfig::default() };
        let seed = info["seed"].as_u64().unwrap();
        let batch = int("batch");
        assert_eq!(int("n_edge"), N_EDGES);
        Self { seed, batch, sizes, config, tolerance, json }
    }

    fn parameters(&self, table: &[ParameterSpec]) -> Vec<f32> {
        let shapes: BTreeMap<&str, Vec<usize>> = self.json["shapes"]
            .as_object()
            .unwrap()
            .iter()
            .map(|(k, v)| (k.as_str(), numbers(v).iter().map(|x| *x as usize).collect()))
            .collect();
        let ours: BTreeMap<&str, Vec<usize>> = table.iter().map(|s| (s.name.as_str(), s.shape.clone())).collect();
        assert_eq!(ours, shapes, "names and shapes of the parameters");
        let mut values = Vec::new();
        for spec in table {
            let x = generate(&format!("param.{}", spec.name), self.seed, spec.n_values());
            let gain = 0.5_f64.min(2.5 / (spec.shape[0] as f64).sqrt());
            let made: Vec<f32> = x
                .iter()
                .map(|x| match spec.name.rsplit('.').next() {
                    Some("w") => (gain * x) as f32,
                    Some("scale") => (1.0 + 0.5 * x) as f32,
                    _ => (0.5 * x) as f32,
                })
                .collect();
            let check = &self.json["param_check"][&spec.name];
            for (value, expected) in made.iter().zip(numbers(&check["first"])) {
                assert_eq!(f64::from(*value), expected, "generator at {}", spec.name);
            }
            values.extend(made);
        }
        values
    }

    fn features(&self) -> FeatureBatch {
        let make = |name: &str, n: usize| -> Vec<f32> {
            generate(&format!("in.{name}"), self.seed, n).into_iter().map(|x| (1.5 * x) as f32).collect()
        };
        let mut batch = batch(self.sizes, self.batch, make);
        let half = self.sizes.global / 2;
        for (k, part) in batch.globals.chunks_exact_mut(half).enumerate() {
            let item = k / 2;
            let gripper = k % 2;
            let one_hot = &mut part[half - 16..];
            one_hot.fill(0.0);
            if (item, gripper) != (1, 1) {
                one_hot[(3 * item + 5 * gripper + 1) % 16] = 1.0;
            }
        }
        for (name, values) in [("nodes", &batch.nodes), ("edges", &batch.edges), ("globals", &batch.globals)] {
            for (value, expected) in values.iter().zip(numbers(&self.json["input_check"][name])) {
                assert_eq!(f64::from(*value), expected, "generator at in.{name}");
            }
        }
        batch
    }

    fn inputs(&self, device: &Device) -> BatchTensors {
        let BatchTensors { nodes, edges, globals } = BatchTensors::new(&self.features(), device);
        BatchTensors { nodes: nodes.require_grad(), edges: edges.require_grad(), globals: globals.require_grad() }
    }

    fn check_outputs(&self, output: &Outputs) {
        let outputs = &self.json["outputs"];
        for (name, ours) in [
            ("block_act_locs", &output.locs),
            ("block_act_scales", &output.scales),
            ("grip_logits", &output.logits),
            ("value", &output.values),
        ] {
            let error = relative_error(ours, &numbers(&outputs[name]));
            assert!(
                error <= self.tolerance,
                "{}: {name} is off by {error:e} of its largest entry",
                self.json["info"]["set"]
            );
        }
    }

    fn check_gradients(&self, network: &Network, expected: &Value, inputs: &BatchTensors, loss: &Tensor<1>) {
        let mut gradients = loss.backward();
        let flat = parameters::flatten_gradients(network, &mut gradients);
        let mut ours = vec![
            ("in.nodes", values(inputs.nodes.grad(&gradients).unwrap())),
            ("in.edges", values(inputs.edges.grad(&gradients).unwrap())),
            ("in.globals", values(inputs.globals.grad(&gradients).unwrap())),
        ];
        ours.extend(parameters::spans(network.table()).map(|(spec, span)| (spec.name.as_str(), flat[span].to_vec())));
        // The value-only gradients are given only for parameters.
        ours.retain(|(name, _)| !name.starts_with("in.") || !expected[name].is_null());
        assert_eq!(ours.len(), expected.as_object().unwrap().len());
        for (name, ours) in ours {
            self.check_gradient(name, &ours, &expected[name]);
        }
    }

    fn check_gradient(&self, name: &str, ours: &[f32], expected: &Value) {
        assert!(expected["l2"].is_f64(), "{name} lacks its gradient");
        let ours = widened(ours);
        let direction = generate(&format!("dir.{name}"), self.seed, ours.len());
        let largest = ours.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        let l2 = expected["l2"].as_f64().unwrap();
        let spread = l2 * (ours.len() as f64).sqrt();
        for (key, value, scale) in [
            ("l2", ours.iter().map(|x| x * x).sum::<f64>().sqrt(), l2),
            ("sum", ours.iter().sum(), spread),
            ("dot", ours.iter().zip(&direction).map(|(g, x)| g * x).sum(), spread),
            ("first", ours[0], largest),
            ("last", ours[ours.len() - 1], largest),
        ] {
            let Some(wanted) = expected[key].as_f64() else { continue };
            let set = &self.json["info"]["set"];
            assert!(
                (value - wanted).abs() <= self.tolerance * scale,
                "{set}: {key} of the gradient of {name} is {value}, not {wanted}"
            );
        }
    }
}

fn check(path: &Path) {
    check_on(&Device::flex().autodiff(), path, TOLERANCE);
}

/// Checks the network on a device with autodiff, and on a CPU the kernels too.
fn check_on(device: &Device, path: &Path, tolerance: f64) {
    let golden = Golden::read(path, tolerance);
    let network = Network::init(&golden.config, &golden.sizes, 0, device);
    let parameters = golden.parameters(network.table());
    if let Some(n) = golden.json["info"]["params"].as_u64() {
        assert_eq!(parameters.len() as u64, n);
    }
    let network = parameters::load(network, &parameters).unwrap();
    assert_eq!(parameters::flatten(&network), parameters, "what goes in comes out");

    let inputs = golden.inputs(device);
    let output = network.forward(&inputs);
    golden.check_outputs(&output.clone().into());
    if *device == Device::flex().autodiff() {
        check_cpu(&golden, network.table(), &parameters);
    }
    let MoveTensors { locs, scales } = output.gaussians().clone();
    let NetworkOutput { logits, values, .. } = output;
    let loss = values.sum() + logits.powi_scalar(2).sum() + locs.powi_scalar(2).sum() + scales.log().sum();
    golden.check_gradients(&network, &golden.json["grads"], &inputs, &loss);

    let value_only = &golden.json["grads_value_only"]["grads"];
    if !value_only.is_null() {
        let inputs = golden.inputs(device);
        let loss = network.forward(&inputs).values.sum();
        golden.check_gradients(&network, value_only, &inputs, &loss);
    }
}

/// Checks the CPU kernels against the same file if they support its network.
fn check_cpu(golden: &Golden, table: &[ParameterSpec], parameters: &[f32]) {
    let Some(layout) = NetworkLayout::new(&golden.config, &golden.sizes, table) else { return };
    let network = CpuNetwork::new(&layout, parameters, true).unwrap();
    let rows: Vec<usize> = (0..golden.batch).collect();
    let mut tape = Tape::default();
    let output = network.forward(&golden.features(), &rows, &mut tape).clone();
    golden.check_outputs(&output);
    if let Some(expected) = golden.json["info"]["attn_mean_of_max_weight"].as_array() {
        let layers = tape.attention();
        assert_eq!(layers.len(), expected.len());
        for (weights, expected) in layers.iter().zip(expected) {
            let rows = weights.as_chunks::<16>().0;
            let mean = rows.iter().map(|row| f64::from(row.iter().copied().fold(0.0, f32::max))).sum::<f64>()
                / rows.len() as f64;
            assert!((mean - expected.as_f64().unwrap()).abs() < 1e-5, "{mean} instead of {expected}");
        }
    }
    let twice = |values: &[f32]| values.iter().map(|x| 2.0 * x).collect::<Vec<f32>>();
    let whole = Outputs {
        locs: twice(&output.locs),
        scales: output.scales.iter().map(|s| 1.0 / s).collect(),
        logits: twice(&output.logits),
        values: vec![1.0; golden.batch],
        readouts: Vec::new(),
    };
    let [locs, scales, logits] = [&whole.locs, &whole.scales, &whole.logits].map(|of| vec![0.0; of.len()]);
    let value_only = Outputs { locs, scales, logits, ..whole.clone() };
    let cases = [(whole, &golden.json["grads"]), (value_only, &golden.json["grads_value_only"]["grads"])];
    let mut gradient = Vec::new();
    for (by_output, expected) in cases.into_iter().filter(|(_, expected)| !expected.is_null()) {
        network.backward(&mut tape, &by_output, &mut gradient);
        for (spec, span) in parameters::spans(table) {
            golden.check_gradient(&spec.name, &gradient[span], &expected[&spec.name]);
        }
    }
}

#[test]
fn graph_attention_matches_the_listing() {
    check(&golden_path("set_a_gat.compact.json"));
}

#[test]
fn equal_weights_match_the_listing() {
    check(&golden_path("set_d_noatt.compact.json"));
}

#[test]
fn resnet_matches_the_listing() {
    check(&golden_path("set_e_resnet_h128.compact.json"));
}

/// On whatever GPU the machine has. Sums are in another order there, and some drivers round products to fewer bits.
#[cfg(feature = "gpu")]
#[test]
fn all_sets_match_the_listing_on_a_gpu() {
    let gpu = policy::DeviceKind::Gpu.open().unwrap().autodiff();
    for name in ["set_a_gat", "set_d_noatt", "set_e_resnet_h128"] {
        check_on(&gpu, &golden_path(&format!("{name}.compact.json")), 1e-4);
    }
}

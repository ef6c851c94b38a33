//! The CPU kernels against burn, in shapes that the golden files do not cover.

use burn::tensor::{Device, Tensor, TensorData};
use policy::cpu::{CpuNetwork, NetworkLayout, Outputs, Tape};
use policy::features::N_EDGES;
use policy::parameters;
use policy::{
    BatchTensors, EncoderConfig, FeatureBatch, FeatureConfig, FeatureSizes, GatConfig, MoveHead, MoveTensors, Network,
    NetworkConfig,
};

use crate::common::{TOLERANCE, generate, relative_error};

fn numbers(name: &str, n: usize) -> Vec<f32> {
    generate(name, 7, n).into_iter().map(|x| x as f32).collect()
}

fn widened(values: &[f32]) -> Vec<f64> {
    values.iter().copied().map(f64::from).collect()
}

fn batch(sizes: FeatureSizes, n: usize) -> FeatureBatch {
    let mut batch = FeatureBatch::new(&FeatureConfig::paper());
    (batch.n, batch.sizes) = (n, sizes);
    batch.nodes = numbers("nodes", n * 16 * sizes.node);
    batch.edges = numbers("edges", n * N_EDGES * sizes.edge);
    batch.globals = numbers("globals", n * sizes.global);
    batch.allowed = vec![true; n * 16];
    batch
}

fn check(name: &str, config: &NetworkConfig, sizes: FeatureSizes, n: usize) {
    let device = Device::flex().autodiff();
    let network = Network::init(config, &sizes, 0, &device);
    let noise = numbers("parameters", network.n_parameters());
    let values: Vec<f32> = parameters::flatten(&network).iter().zip(noise).map(|(p, x)| p + 0.1 * x).collect();
    let network = parameters::load(network, &values).unwrap();
    // More rows than scenes in the batch, in another order.
    let batch = batch(sizes, n);
    let rows: Vec<usize> = (0..n).rev().chain([0]).collect();
    let inputs = BatchTensors::new(&batch.select(&rows), &device);
    let expected = network.forward(&inputs);

    let layout = NetworkLayout::new(config, &sizes, network.table()).unwrap();
    let cpu = CpuNetwork::new(&layout, &values, true).unwrap();
    let mut tape = Tape::default();
    let found = cpu.forward(&batch, &rows, &mut tape).clone();
    assert_eq!(cpu.infer(&batch, &rows, &mut Tape::default()), &found, "{name}: both ways forward");
    let wanted = Outputs::from(expected.clone());
    let parts = [
        ("locs", &found.locs, &wanted.locs),
        ("scales", &found.scales, &wanted.scales),
        ("logits", &found.logits, &wanted.logits),
        ("values", &found.values, &wanted.values),
        ("readouts", &found.readouts, &wanted.readouts),
    ];
    for (part, found, wanted) in parts {
        let error = relative_error(found, &widened(wanted));
        assert!(error < TOLERANCE, "{name}: {part} off by {error:e}");
    }

    let by_output = Outputs {
        locs: numbers("d locs", found.locs.len()),
        scales: numbers("d scales", found.scales.len()),
        logits: numbers("d logits", found.logits.len()),
        values: numbers("d values", found.values.len()),
        readouts: numbers("d readouts", found.readouts.len()),
    };
    let cube = |values: &[f32], like: &Tensor<3>| {
        Tensor::<3>::from_data(TensorData::new(values.to_vec(), like.dims()), &device)
    };
    let weights = Tensor::<1>::from_data(TensorData::new(by_output.values.clone(), [rows.len()]), &device);
    let product = |output: &Tensor<3>, by_output: &[f32]| (output.clone() * cube(by_output, output)).sum();
    let loss = product(&expected.logits, &by_output.logits) + (expected.values * weights).sum();
    let loss = match (&expected.moves, &expected.readouts) {
        (Some(MoveTensors { locs, scales }), None) => {
            loss + product(locs, &by_output.locs) + product(scales, &by_output.scales)
        }
        (None, Some(readouts)) => loss + product(readouts, &by_output.readouts),
        heads => panic!("{name}: one of the heads, not {heads:?}"),
    };
    let wanted = parameters::flatten_gradients(&network, &mut loss.backward());
    let mut gradient = vec![f32::NAN; 3];
    cpu.backward(&mut tape, &by_output, &mut gradient);
    for (spec, span) in parameters::spans(network.table()) {
        let error = relative_error(&gradient[span.clone()], &widened(&wanted[span]));
        assert!(error < TOLERANCE, "{name}: the gradient of {} is off by {error:e}", spec.name);
    }
}

#[test]
fn kernels_equal_burn_whatever_the_shape() {
    let default = NetworkConfig::default();
    let gat = GatConfig::default();
    let with = |gat| NetworkConfig { encoder: EncoderConfig::Gat(gat), ..default.clone() };
    let paper = FeatureSizes::new(&FeatureConfig::paper());
    check("all features", &default, FeatureSizes::new(&FeatureConfig::default()), 11);
    check("read-outs", &NetworkConfig { move_head: MoveHead::Mixture, ..default.clone() }, paper, 9);
    check("equal weights", &with(GatConfig { attention: false, ..gat }), paper, 3);
    // Nodes have more features than the network's width, so the first layer does not attend to raw features. No size is
    // a multiple of a vector's width.
    let odd = NetworkConfig {
        width: 20,
        value_hidden: vec![13],
        init_std: Some(0.3),
        ..with(GatConfig { n_layers: 2, n_heads: 3, head_dim: 7, mlp_hidden: 21, ..gat })
    };
    check("odd sizes", &odd, FeatureSizes { node: 30, edge: 5, global: 25, n_grippers: 1 }, 9);
    check(
        "a linear value",
        &NetworkConfig { value_hidden: Vec::new(), ..odd },
        FeatureSizes { node: 2, edge: 1, global: 17, n_grippers: 1 },
        1,
    );
}

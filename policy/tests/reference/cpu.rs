//! The CPU kernels against burn, in shapes that the golden files do not cover.

use burn::tensor::{Device, Tensor, TensorData};
use policy::cpu::{CpuNetwork, NetworkLayout, Outputs, Tape};
use policy::parameters::{self, ParameterSpec};
use policy::{
    BatchTensors, EncoderConfig, FeatureBatch, FeatureConfig, FeatureSizes, GatConfig, MoveHead, MoveTensors, Network,
    NetworkConfig,
};

use crate::common::{TOLERANCE, batch, generate, relative_error, widened};

fn numbers(name: &str, n: usize) -> Vec<f32> {
    generate(name, 7, n).into_iter().map(|x| x as f32).collect()
}

fn check(name: &str, config: &NetworkConfig, sizes: FeatureSizes, n: usize) {
    let device = Device::flex().autodiff();
    let network = Network::init(config, &sizes, 0, &device);
    let initial = parameters::flatten(&network);
    let noise = numbers("parameters", initial.len());
    let values: Vec<f32> = initial.iter().zip(noise).map(|(p, x)| p + 0.1 * x).collect();
    let network = parameters::load(network, &values).unwrap();
    // More rows than scenes in the batch, in another order.
    let batch = batch(sizes, n, numbers);
    let rows: Vec<usize> = (0..n).rev().chain([0]).collect();
    let inputs = BatchTensors::new(&batch.select(&rows), &device);
    let expected = network.forward(&inputs);

    let layout = NetworkLayout::new(config, &sizes, network.table()).unwrap();
    let cpu = CpuNetwork::new(&layout, &values, true).unwrap();
    let mut tape = Tape::default();
    let found = cpu.forward(&batch, &rows, &mut tape).clone();
    assert_eq!(cpu.infer(&batch, &rows, &mut Tape::default()), &found, "{name}: both ways forward");
    let wanted = Outputs::from(expected.clone());
    if let EncoderConfig::Gat(GatConfig { attention: false, n_layers, .. }) = config.encoder {
        let seen = tape.attention();
        assert_eq!(seen.len(), n_layers, "{name}");
        let is_equal = |i: usize, weight: f32| weight == if i / 16 % 16 == i % 16 { 0.0 } else { 1.0 / 15.0 };
        for weights in seen {
            assert_eq!(weights.len(), rows.len() * 16 * 16, "{name}");
            assert!(weights.iter().enumerate().all(|(i, weight)| is_equal(i, *weight)), "{name}: {weights:?}");
        }
    }
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
    // No size is a multiple of a vector's width, and the heads together are not as wide as the MLP.
    let odd_gat = GatConfig { n_layers: 2, n_heads: 3, head_dim: 7, mlp_hidden: 23, ..gat };
    check("odd heads", &with(odd_gat), paper, 3);
    check("equal weights", &with(GatConfig { attention: false, ..odd_gat }), paper, 3);
    // Nodes have more features than the network's width, so the first layer does not attend to raw features.
    let odd = NetworkConfig { width: 20, value_hidden: vec![13], init_std: Some(0.3), ..with(odd_gat) };
    check("odd sizes", &odd, FeatureSizes { node: 30, edge: 5, global: 25, n_grippers: 1 }, 9);
    check(
        "a linear value",
        &NetworkConfig { value_hidden: Vec::new(), ..odd },
        FeatureSizes { node: 2, edge: 1, global: 17, n_grippers: 1 },
        1,
    );
}

/// The golden files have two grippers.
#[test]
fn one_gripper_equals_two_of_which_the_second_is_absent() {
    const N_SCENES: usize = 5;
    let config = NetworkConfig { init_std: Some(0.3), ..NetworkConfig::default() };
    let width = config.width;
    let both = FeatureSizes::new(&FeatureConfig::paper());
    let alone = FeatureSizes { global: both.global / 2, n_grippers: 1, ..both };
    let forward = |sizes: FeatureSizes, values: &[f32], batch: &FeatureBatch| {
        let network = Network::init(&config, &sizes, 0, &Device::flex());
        let layout = NetworkLayout::new(&config, &sizes, network.table()).unwrap();
        let cpu = CpuNetwork::new(&layout, values, false).unwrap();
        cpu.infer(batch, &(0..N_SCENES).collect::<Vec<_>>(), &mut Tape::default()).clone()
    };
    let table = Network::init(&config, &both, 0, &Device::flex()).table().to_vec();
    let n_values = table.iter().map(ParameterSpec::n_values).sum();
    let mut values: Vec<f32> = numbers("parameters", n_values).iter().map(|x| 0.1 * x).collect();
    let mut of_first = Vec::new();
    for (spec, span) in parameters::spans(&table) {
        let x = &mut values[span];
        match spec.name.as_str() {
            "embed_global.w" | "head.input_global.w" | "value.input_global.w" => of_first.extend(&x[..x.len() / 2]),
            "head.block_key.w" => of_first.extend(&x[..(width + 1) * width]),
            "head.grip_key.w" => x.chunks_exact(2 * width).for_each(|row| of_first.extend(&row[..width])),
            "value.mlp.0.w" => {
                // What the second gripper would choose does not matter.
                let n_kept = x.len() - 16 * spec.shape[1];
                x[n_kept..].fill(0.0);
                of_first.extend(&x[..n_kept]);
            }
            _ => of_first.extend(&*x),
        }
    }
    let mut two = batch(both, N_SCENES, numbers);
    let mut one = batch(alone, N_SCENES, numbers);
    for (two, one) in two.globals.chunks_exact_mut(both.global).zip(one.globals.chunks_exact_mut(alone.global)) {
        one.copy_from_slice(&two[..alone.global]);
        two[alone.global..].fill(0.0);
    }
    let (two, one) = (forward(both, &values, &two), forward(alone, &of_first, &one));
    let first_logits: Vec<f32> = two.logits.chunks_exact(32).flat_map(|both| both[..16].to_vec()).collect();
    for (found, wanted) in
        [(&one.logits, &first_logits), (&one.locs, &two.locs), (&one.scales, &two.scales), (&one.values, &two.values)]
    {
        let error = relative_error(found, &widened(wanted));
        assert!(error < TOLERANCE, "off by {error:e}");
    }
}

#[test]
fn each_head_has_its_attention() {
    let config = NetworkConfig { init_std: Some(0.3), ..NetworkConfig::default() };
    let EncoderConfig::Gat(GatConfig { n_heads, head_dim, .. }) = config.encoder else { panic!("{config:?}") };
    let sizes = FeatureSizes::new(&FeatureConfig::paper());
    let table = Network::init(&config, &sizes, 0, &Device::flex()).table().to_vec();
    let mut values = numbers("parameters", table.iter().map(ParameterSpec::n_values).sum());
    for (spec, span) in parameters::spans(&table).filter(|(spec, _)| spec.name == "layer0.query.w") {
        // A head without queries attends to all others alike.
        let rows = values[span].chunks_exact_mut(n_heads * head_dim);
        assert_eq!(spec.shape[1], n_heads * head_dim);
        rows.for_each(|row| row[head_dim..2 * head_dim].fill(0.0));
    }
    let layout = NetworkLayout::new(&config, &sizes, &table).unwrap();
    let mut tape = Tape::default();
    CpuNetwork::new(&layout, &values, true).unwrap().forward(&batch(sizes, 1, numbers), &[0], &mut tape);
    for (i, row) in tape.attention()[0].as_chunks::<16>().0.iter().enumerate() {
        let [receiver, head] = [i / n_heads, i % n_heads];
        let is_even =
            (0..16).filter(|sender| *sender != receiver).all(|sender| (row[sender] - 1.0 / 15.0).abs() < 1e-6);
        assert_eq!(is_even, head == 1, "block {receiver}, head {head}: {row:?}");
    }
}

//! Forward passes, updates, and decisions of the paper's network in samples per CPU-second, on one thread.
//!
//! `cargo bench -p lab --bench network`; `lab/benches/peers.py` runs it together with JAX and PyTorch and prints the ratios.
//! Arguments: `forward`, `update`, or `decide` for one of the three, `burn` to use burn's tensors, `extended` for all
//! features instead of the paper's. A decision is everything from a scene to an action; it is made with both heads.

use std::hint::black_box;
use std::time::{Duration, Instant};

use blueprints::{Blueprint, Catalog, N_BLOCKS, Split};
use burn::tensor::Device;
use policy::cpu::{CpuNetwork, NetworkLayout, Outputs, Tape};
use policy::{
    BatchTensors, FeatureBatch, FeatureConfig, FeatureSizes, MoveHead, Network, NetworkConfig, Policy, PolicyConfig,
    parameters,
};
use proto::{ActionMode, Agent, Joint, Observation, Pose, Scene, Valid};
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;

const FORWARD_BATCHES: [usize; 3] = [1, 16, 64];
const UPDATE_BATCHES: [usize; 4] = [64, 128, 256, 512];

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let has = |wanted: &str| arguments.iter().any(|a| a == wanted);
    let config = if has("extended") { FeatureConfig::default() } else { FeatureConfig::paper() };
    let sizes = FeatureSizes::new(&config);
    println!("features {}/{}/{}", sizes.node, sizes.edge, sizes.global);
    let network = Network::init(&NetworkConfig::default(), &sizes, 0, &Device::flex().autodiff());
    if !has("forward") && !has("update") && !has("burn") {
        [MoveHead::Gaussian, MoveHead::Mixture].into_iter().for_each(|head| decide(head, &config));
    }
    for b in FORWARD_BATCHES.into_iter().filter(|_| !has("update") && !has("decide")) {
        if has("burn") { forward_on_burn(&sizes, b) } else { forward(&network, &config, b) }
    }
    for b in UPDATE_BATCHES.into_iter().filter(|_| !has("forward") && !has("decide")) {
        if has("burn") { update_on_burn(&network, &config, b) } else { update(&network, &config, b) }
    }
}

/// Builds the CPU kernels of a network.
fn cpu(network: &Network, config: &FeatureConfig, with_gradients: bool) -> CpuNetwork {
    let layout = NetworkLayout::new(&NetworkConfig::default(), &FeatureSizes::new(config), network.table());
    CpuNetwork::new(&layout.expect("a graph network"), &parameters::flatten(network), with_gradients)
        .expect("finite parameters")
}

fn forward(network: &Network, config: &FeatureConfig, b: usize) {
    let network = cpu(network, config, false);
    let batch = batch(config, b);
    let (rows, mut tape): (Vec<usize>, _) = ((0..b).collect(), Tape::default());
    report("forward", b, || {
        black_box(network.infer(&batch, &rows, &mut tape));
    });
}

fn forward_on_burn(sizes: &FeatureSizes, b: usize) {
    let device = Device::flex();
    let network = Network::init(&NetworkConfig::default(), sizes, 0, &device);
    let config = if sizes.node == 3 { FeatureConfig::paper() } else { FeatureConfig::default() };
    let batch = BatchTensors::new(&batch(&config, b), &device);
    let folded = network.fold();
    report("burn forward", b, || {
        let output = network.forward_folded(&folded, &batch);
        black_box(output.values.into_data());
    });
}

/// Measures passes with the loss of the golden files: values + squares of logits and means + logarithms of deviations.
fn update(network: &Network, config: &FeatureConfig, b: usize) {
    let network = cpu(network, config, true);
    let batch = batch(config, b);
    let (rows, mut tape): (Vec<usize>, _) = ((0..b).collect(), Tape::default());
    let mut gradient = Vec::new();
    report("update", b, || {
        let output = network.forward(&batch, &rows, &mut tape);
        let by_output = Outputs {
            locs: output.locs.iter().map(|x| 2.0 * x).collect(),
            scales: output.scales.iter().map(|s| 1.0 / s).collect(),
            logits: output.logits.iter().map(|x| 2.0 * x).collect(),
            values: vec![1.0; b],
            readouts: Vec::new(),
        };
        network.backward(&mut tape, &by_output, &mut gradient);
        black_box(&gradient);
    });
}

fn update_on_burn(network: &Network, config: &FeatureConfig, b: usize) {
    let batch = BatchTensors::new(&batch(config, b), &Device::flex().autodiff());
    report("burn update", b, || {
        let output = network.forward(&batch);
        let moves = output.gaussians().clone();
        let loss = output.values.sum()
            + output.logits.powi_scalar(2).sum()
            + moves.locs.clone().powi_scalar(2).sum()
            + moves.scales.clone().log().sum();
        let mut gradients = loss.backward();
        black_box(parameters::flatten_gradients(network, &mut gradients));
    });
}

/// Decides on a half-built structure of each training goal of 12 to 16 blocks.
fn decide(head: MoveHead, features: &FeatureConfig) {
    let network = NetworkConfig { move_head: head, ..NetworkConfig::default() };
    let config = PolicyConfig { network, features: *features, ..PolicyConfig::default() };
    let config = Valid::new(config).expect("a valid configuration");
    let mut policy = Policy::new(&config);
    let goals: Vec<&Blueprint> =
        Catalog::builtin().of_split(Split::Train).into_iter().filter(|goal| goal.n_blocks() >= 12).collect();
    let scenes: Vec<Scene> = goals.iter().map(|goal| half_built(goal)).collect();
    let seen: Vec<Observation<'_>> =
        scenes.iter().zip(goals).map(|(scene, blueprint)| Observation { scene, blueprint }).collect();
    let modes = vec![ActionMode::Sampled; seen.len()];
    let mut rngs: Vec<ChaCha8Rng> = (0..seen.len() as u64).map(ChaCha8Rng::seed_from_u64).collect();
    let name = if head == MoveHead::Mixture { "decide mixture" } else { "decide gaussian" };
    report(name, seen.len(), || {
        black_box(policy.act(&seen, &modes, &mut rngs)).expect("a decision");
    });
}

/// Half of a goal's blocks are in place half a meter above the ground, and the others lie in a row.
fn half_built(goal: &Blueprint) -> Scene {
    let n_placed = goal.n_blocks() / 2;
    let lying = |i: usize| Pose { position: [0.3 * i as f32 - 2.0, 1.0, 0.05], orientation: [0.0, 0.6, 0.0, 0.8] };
    let mut blocks: [Pose; N_BLOCKS] = std::array::from_fn(lying);
    for placement in &goal.placements()[..n_placed] {
        let position = placement.position_m() + nalgebra::Vector3::z() * 0.5;
        let orientation = placement.rotation.quaternion().coords.into();
        blocks[placement.block.get()] = Pose { position: position.into(), orientation };
    }
    let placed = &goal.placements()[..n_placed];
    let is_placed = |block| placed.iter().any(|placement| placement.block == block);
    let made = goal.links().iter().filter(|link| is_placed(link.a) && is_placed(link.b));
    let joints = made.map(|link| Joint { a: link.a, b: link.b, relative: link.relative }).collect();
    Scene { joints, ..Scene::at_rest(blocks) }
}

fn batch(config: &FeatureConfig, b: usize) -> FeatureBatch {
    let fill = |n: usize| (0..n).map(|i| ((i * 7919) % 2003) as f32 / 1001.0 - 1.0).collect();
    let mut batch = FeatureBatch::new(config);
    let FeatureSizes { node, edge, global, .. } = batch.sizes;
    batch.n = b;
    (batch.nodes, batch.edges, batch.globals) = (fill(b * 16 * node), fill(b * 240 * edge), fill(b * global));
    batch.allowed = vec![[true; 16]; b];
    batch
}

/// Prints the best of several rounds, so that other load on the machine has little effect.
fn report(name: &str, b: usize, mut work: impl FnMut()) {
    for _ in 0..3 {
        work();
    }
    let mut best = f64::INFINITY;
    let end = Instant::now() + Duration::from_secs(4);
    while Instant::now() < end {
        let n = (64 / b).max(1);
        let start = cpu_time();
        for _ in 0..n {
            work();
        }
        best = best.min((cpu_time() - start).as_secs_f64() / (n * b) as f64);
    }
    println!("{name} {b} {:.4} ms/sample {:.0} samples/s", best * 1e3, 1.0 / best);
}

/// Returns the CPU time of all threads on Linux, and wall-clock time elsewhere.
///
/// Includes all threads because batched products run on a worker of the thread pool even if the pool has only one.
fn cpu_time() -> Duration {
    let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let spent = |path: std::path::PathBuf| -> Option<u64> {
        std::fs::read_to_string(path.join("schedstat")).ok()?.split(' ').next()?.parse().ok()
    };
    let nanoseconds: Vec<u64> = tasks.filter_map(|task| spent(task.path())).collect();
    if nanoseconds.is_empty() { START.with(Instant::elapsed) } else { Duration::from_nanos(nanoseconds.iter().sum()) }
}

thread_local! {
    static START: Instant = Instant::now();
}

//! Forward passes and updates of the paper's network in samples per CPU-second, on one thread.
//!
//! `cargo bench -p policy` on one thread; `benches/jax_peer.py` runs the same work in JAX and prints the ratio.
//! With arguments `forward <batch>` or `update <batch>` only that case runs.

use std::hint::black_box;
use std::time::{Duration, Instant};

use burn::tensor::{Device, Tensor, TensorData};
use policy::{BatchTensors, FeatureConfig, FeatureSizes, Network, NetworkConfig, parameters};

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let features =
        if arguments.iter().any(|a| a == "extended") { FeatureConfig::default() } else { FeatureConfig::paper() };
    let wanted = |kind: &str| arguments.is_empty() || arguments.iter().any(|a| a == kind || a == "extended");
    let sizes = FeatureSizes::new(&features);
    println!("features {}/{}/{}", sizes.node, sizes.edge, sizes.global);
    for b in [1, 16, 64] {
        if wanted("forward") {
            forward(&sizes, b);
        }
    }
    for b in [64, 128, 256, 512] {
        if wanted("update") {
            update(&sizes, b);
        }
    }
}

fn forward(sizes: &FeatureSizes, b: usize) {
    let device = Device::flex();
    let network = Network::init(&NetworkConfig::default(), sizes, 0, &device);
    let batch = batch(sizes, b, &device);
    let folded = network.fold();
    report("forward", b, || {
        let output = network.forward_folded(&folded, &batch);
        black_box(output.values.into_data());
    });
}

fn update(sizes: &FeatureSizes, b: usize) {
    let device = Device::flex().autodiff();
    let network = Network::init(&NetworkConfig::default(), sizes, 0, &device);
    let batch = batch(sizes, b, &device);
    report("update", b, || {
        let output = network.forward(&batch);
        let loss = output.values.sum()
            + output.logits.powi_scalar(2).sum()
            + output.locs.powi_scalar(2).sum()
            + output.scales.log().sum();
        let mut gradients = loss.backward();
        black_box(parameters::flatten_gradients(&network, &mut gradients));
    });
}

fn batch(sizes: &FeatureSizes, b: usize, device: &Device) -> BatchTensors {
    let fill = |shape: [usize; 3]| {
        let n = shape.iter().product::<usize>();
        let values: Vec<f32> = (0..n).map(|i| ((i * 7919) % 2003) as f32 / 1001.0 - 1.0).collect();
        Tensor::<3>::from_data(TensorData::new(values, shape), device)
    };
    BatchTensors {
        nodes: fill([b, 16, sizes.node]),
        edges: fill([b, 256, sizes.edge]),
        globals: fill([b, 1, sizes.global]).squeeze_dim(1),
    }
}

/// The best of several rounds, so that other load on the machine counts little.
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

/// Time that all threads spent on a CPU where the system tells (Linux), else wall time.
///
/// All threads count: batched products run on a worker of the thread pool even when the pool has only one.
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

//! Readers for the golden files, of the learner too, and the generator of their parameters and inputs.

use std::path::{Path, PathBuf};

use blueprints::{BlockIdx, N_BLOCKS};
use burn::tensor::Tensor;
use policy::cpu::Outputs;
use policy::features::N_EDGES;
use policy::{FeatureBatch, FeatureConfig, FeatureSizes};
use proto::Action;
use serde_json::Value;

/// Largest relative error of results in `f32`.
pub(crate) const TOLERANCE: f64 = 2e-5;

/// Returns the path of `tests/golden/<name>`.
pub(crate) fn golden_path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name)
}

pub(crate) fn read_json(path: &Path) -> Value {
    let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Returns the file with a batch for PPO.
pub(crate) fn read_ppo() -> Value {
    read_json(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../learner/tests/golden/ppo.json"))
}

/// Returns the actions of that batch.
pub(crate) fn actions(golden: &Value) -> Vec<Action> {
    let blocks = numbers(&golden["action"]["block"]);
    let moves = floats(&golden["action"]["move_matrix_16x6"]);
    let action = |(blocks, moves): (&[f64], &[f32])| Action {
        choices: std::array::from_fn(|g| BlockIdx::try_from(blocks[g] as u8).ok()),
        moves: std::array::from_fn(|b| std::array::from_fn(|k| moves[6 * b + k])),
    };
    blocks.chunks_exact(2).zip(moves.chunks_exact(6 * N_BLOCKS)).map(action).collect()
}

/// Returns the outputs of a network for that batch.
pub(crate) fn outputs(golden: &Value) -> Outputs {
    let [locs, scales, logits, values] = ["locs", "scales", "grip_logits", "value"].map(|name| floats(&golden[name]));
    Outputs { locs, scales, logits, values, readouts: Vec::new() }
}

/// Returns all numbers of a nested array in row-major order.
pub(crate) fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(items) => items.iter().flat_map(numbers).collect(),
        other => vec![other.as_f64().unwrap_or_else(|| panic!("{other} is not a number"))],
    }
}

pub(crate) fn floats(value: &Value) -> Vec<f32> {
    numbers(value).into_iter().map(|x| x as f32).collect()
}

pub(crate) fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_to_vec().unwrap()
}

/// The golden files' generator: returns `n` numbers in [−1, 1) for a tensor name and a seed, exact in `f32`.
pub(crate) fn generate(name: &str, seed: u64, n: usize) -> Vec<f64> {
    const GOLDEN_RATIO: u64 = 0x9E37_79B9_7F4A_7C15;
    let hash = name.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x100_0000_01b3));
    let start = hash ^ seed.wrapping_mul(GOLDEN_RATIO);
    let finalise = |mut z: u64| {
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    };
    (1..=n as u64)
        .map(|i| (finalise(start.wrapping_add(i.wrapping_mul(GOLDEN_RATIO))) >> 40) as f64 / f64::from(1 << 23) - 1.0)
        .collect()
}

/// Returns a batch of `n` scenes with the features that `make` returns for a name and their number.
pub(crate) fn batch(sizes: FeatureSizes, n: usize, make: impl Fn(&str, usize) -> Vec<f32>) -> FeatureBatch {
    let mut batch = FeatureBatch::new(&FeatureConfig::paper());
    (batch.n, batch.sizes) = (n, sizes);
    batch.nodes = make("nodes", n * 16 * sizes.node);
    batch.edges = make("edges", n * N_EDGES * sizes.edge);
    batch.globals = make("globals", n * sizes.global);
    batch.allowed = vec![[true; 16]; n];
    batch
}

pub(crate) fn widened(values: &[f32]) -> Vec<f64> {
    values.iter().copied().map(f64::from).collect()
}

/// Returns the largest |x − y| relative to the largest |y|.
pub(crate) fn relative_error(x: &[f32], y: &[f64]) -> f64 {
    assert_eq!(x.len(), y.len());
    let scale = y.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    let worst = x.iter().zip(y).fold(0.0_f64, |m, (a, b)| m.max((f64::from(*a) - b).abs()));
    if worst == 0.0 { 0.0 } else { worst / scale }
}

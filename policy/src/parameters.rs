//! Parameters as one flat vector in a documented order, and their initial values.
//!
//! The order is that of [`crate::Network`]'s [`table`](crate::Network::table): encoder (graph: `embed_node`,
//! `embed_edge`, `embed_global`, then per layer `message`, `query`, `key`, `node_proj`, `ln_attn`, `mlp_node`,
//! `ln_mlp`, `mlp_global`, `ln_global`; flat: `in`, the residual blocks, `to_nodes`, `to_global`), policy head, value
//! head. Each kernel precedes its bias and is row-major `[in, out]`. Without attention, `query` and `key` do not exist.

use std::ops::Range;

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Device, Gradients, Tensor, TensorData};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::distribution::unit_normal;

/// Number of values that a digest takes at a time.
const BLOCK: usize = 1024;

/// Name and shape of one parameter.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ParameterSpec {
    /// For example `layer0.message.w`.
    pub name: String,
    /// `[in, out]` for kernels, `[out]` for all others.
    pub shape: Vec<usize>,
}

/// Initial values of one parameter.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Initializer {
    /// The same value everywhere.
    Constant(f32),
    /// Haiku's default for kernels: normal with σ = 1/√fan_in, truncated at 2σ. The variance is *not* corrected for the
    /// truncation, so the standard deviation of the values is 0.88 σ.
    HaikuLinear,
    /// Haiku's `VarianceScaling(scale)`: like [`Initializer::HaikuLinear`] with σ = √(scale / fan_in), corrected for
    /// the truncation.
    FanIn(f32),
    /// Haiku's `VarianceScaling(scale, fan_out, uniform)`: uniform in ±√(3 · scale / fan_out).
    UniformFanOut(f32),
}

/// Why a parameter vector is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ParameterError(String);

impl ParameterSpec {
    /// Returns the number of values.
    pub fn n_values(&self) -> usize {
        self.shape.iter().product()
    }
}

/// Returns each parameter of a table with its range in the flat vector.
pub fn spans(table: &[ParameterSpec]) -> impl Iterator<Item = (&ParameterSpec, Range<usize>)> {
    let mut end = 0;
    table.iter().map(move |spec| {
        let start = end;
        end += spec.n_values();
        (spec, start..end)
    })
}

/// Returns all parameters of `network` in the order of its table.
pub fn flatten(network: &impl Module) -> Vec<f32> {
    let mut visitor = Flatten { values: Vec::with_capacity(network.num_params()) };
    network.visit(&mut visitor);
    visitor.values
}

/// Returns the network with its parameters replaced.
///
/// # Errors
/// If the number of values is wrong or one of them is not finite.
pub fn load<M: Module>(network: M, values: &[f32]) -> Result<M, ParameterError> {
    check(values, network.num_params())?;
    Ok(network.map(&mut Load { values, at: 0 }))
}

/// Checks that there are `expected` parameters, all finite.
pub(crate) fn check(values: &[f32], expected: usize) -> Result<(), ParameterError> {
    if values.len() != expected {
        return Err(ParameterError(format!("{} parameters given, the network has {expected}", values.len())));
    }
    let wrong = values.iter().position(|x| !x.is_finite());
    wrong.map_or(Ok(()), |index| Err(ParameterError(format!("parameter {index} is not finite"))))
}

/// Returns the SHA-256 digest of parameters, as 64 hexadecimal digits: of the name, the number of dimensions, the
/// dimensions, and the values of each tensor, in the order of `table`. Numbers are little-endian, and counts have 64
/// bits. A name is preceded by its length in bytes.
///
/// `values` must have as many entries as the tensors in `table`; others are not part of the digest.
pub fn digest(table: &[ParameterSpec], mut values: &[f32]) -> String {
    let mut digest = Sha256::new();
    for spec in table {
        digest.update((spec.name.len() as u64).to_le_bytes());
        digest.update(&spec.name);
        digest.update((spec.shape.len() as u64).to_le_bytes());
        spec.shape.iter().for_each(|n| digest.update((*n as u64).to_le_bytes()));
        let (own, rest) = values.split_at(spec.n_values().min(values.len()));
        for block in own.chunks(BLOCK) {
            let mut bytes = [0; 4 * BLOCK];
            bytes.as_chunks_mut::<4>().0.iter_mut().zip(block).for_each(|(place, x)| *place = x.to_le_bytes());
            digest.update(&bytes[..4 * block.len()]);
        }
        values = rest;
    }
    digest.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Returns the gradients of all parameters in the order of the table; 0 where the loss does not depend on a parameter.
///
/// `network` must be the one whose forward pass computed the loss.
pub fn flatten_gradients(network: &impl Module, gradients: &mut Gradients) -> Vec<f32> {
    let mut visitor = FlattenGradients { gradients, values: Vec::with_capacity(network.num_params()) };
    network.visit(&mut visitor);
    visitor.values
}

/// Draws initial values of the parameters in `table`, from one stream of random numbers per call.
pub(crate) fn initial_values(table: &[ParameterSpec], initializers: &[Initializer], seed: u64) -> Vec<f32> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut values = Vec::with_capacity(table.iter().map(ParameterSpec::n_values).sum());
    for (spec, initializer) in table.iter().zip(initializers) {
        let fan_in = spec.shape.first().copied().unwrap_or(1).max(1) as f32;
        let fan_out = spec.shape.last().copied().unwrap_or(1).max(1) as f32;
        for _ in 0..spec.n_values() {
            values.push(match *initializer {
                Initializer::Constant(x) => x,
                Initializer::HaikuLinear => truncated_normal(&mut rng) / fan_in.sqrt(),
                Initializer::FanIn(scale) => truncated_normal(&mut rng) * (scale / fan_in).sqrt() / TRUNCATED_STD,
                Initializer::UniformFanOut(scale) => {
                    let limit = (3.0 * scale / fan_out).sqrt();
                    rng.random_range(-limit..limit)
                }
            });
        }
    }
    values
}

/// Standard deviation of a unit normal truncated at ±2.
const TRUNCATED_STD: f32 = 0.879_625_7;

fn truncated_normal(rng: &mut ChaCha8Rng) -> f32 {
    loop {
        let x = unit_normal(rng);
        if x.abs() <= 2.0 {
            return x;
        }
    }
}

struct Flatten {
    values: Vec<f32>,
}

impl ModuleVisitor for Flatten {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        self.values.extend(to_vec(param.val()));
    }
}

struct FlattenGradients<'a> {
    gradients: &'a mut Gradients,
    values: Vec<f32>,
}

impl ModuleVisitor for FlattenGradients<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        self.values.extend(gradient(&param.val(), self.gradients));
    }
}

/// Copies values to a device. With autodiff, [`gradient`] can take the gradient with respect to the tensor.
pub(crate) fn leaf<const D: usize>(values: &[f32], shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values.to_vec(), shape), device).set_require_grad(device.is_autodiff())
}

/// Takes the gradient of a tensor; 0 where the loss does not depend on it.
pub(crate) fn gradient<const D: usize>(tensor: &Tensor<D>, gradients: &mut Gradients) -> Vec<f32> {
    match tensor.grad_remove(gradients) {
        Some(gradient) => to_vec(gradient),
        None => vec![0.0; tensor.shape().num_elements()],
    }
}

pub(crate) fn to_vec<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_to_vec().expect("the network computes in f32")
}

struct Load<'a> {
    values: &'a [f32],
    at: usize,
}

impl ModuleMapper for Load<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        param.map(|old| {
            let shape = old.shape();
            let n = shape.num_elements();
            let data = TensorData::new(self.values[self.at..self.at + n].to_vec(), shape);
            self.at += n;
            let tracked = old.is_require_grad();
            Tensor::from_data(data, &old.device()).set_require_grad(tracked)
        })
    }
}

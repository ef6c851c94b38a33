//! The logits of recorded draws on tensors.

use burn::tensor::{Device, Int, Tensor, TensorData};

use super::{ActionRows, D, N, N_READOUTS, ROOT, Row};
use crate::distribution::MASKED_LOGIT;
use crate::parameters::leaf;

/// Logits of the draws of B recorded actions on a device.
#[derive(Clone, Debug)]
pub struct DrawLogits {
    /// The first gripper's proposals `[B, K]`; [`MASKED_LOGIT`] beyond those that a scene has.
    pub first: Tensor<2>,
    /// What the first draw adds to the logits of the second gripper's blocks `[B, 16]`.
    pub blocks: Tensor<2>,
    /// The second gripper's proposals `[B, K]`.
    pub second: Tensor<2>,
}

/// Gradients of [`DrawLogits`], or the logits themselves, as plain numbers.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct DrawNumbers(pub(crate) [Vec<f32>; 3]);

/// Returns the number of options in the widest row of a kind, at least 1: `[first, blocks, second]`.
fn widths(draws: &[&ActionRows]) -> [usize; 3] {
    std::array::from_fn(|part| draws.iter().map(|rows| rows.all()[part].len()).max().unwrap_or(0).max(1))
}

impl DrawNumbers {
    /// Computes the logits from the read-outs of all scenes `[B, 16, N_READOUTS]`.
    pub(crate) fn new(draws: &[&ActionRows], readouts: &[f32]) -> Self {
        let widths = widths(draws);
        Self(std::array::from_fn(|part| {
            let mut logits = Vec::with_capacity(draws.len() * widths[part]);
            for (i, (rows, readouts)) in draws.iter().zip(readouts.chunks_exact(N * N_READOUTS)).enumerate() {
                rows.all()[part].logits(readouts, &mut logits);
                logits.resize((i + 1) * widths[part], MASKED_LOGIT);
            }
            logits
        }))
    }

    /// Copies the numbers to a device. With autodiff, they are leaves of its graph.
    pub(crate) fn to_tensors(&self, n: usize, device: &Device) -> DrawLogits {
        let [first, blocks, second] =
            self.0.each_ref().map(|numbers| leaf(numbers, [n, numbers.len() / n.max(1)], device));
        DrawLogits { first, blocks, second }
    }

    /// Returns the gradient of the read-outs, given `self` as the gradient of the logits.
    pub(crate) fn by_readouts(&self, draws: &[&ActionRows], readouts: &[f32]) -> Vec<f32> {
        let mut gradient = vec![0.0; readouts.len()];
        for (part, by_logit) in self.0.iter().enumerate() {
            let width = by_logit.len() / draws.len().max(1);
            let scenes = readouts.chunks_exact(N * N_READOUTS).zip(gradient.chunks_exact_mut(N * N_READOUTS));
            for ((rows, by_logit), (readouts, to)) in draws.iter().zip(by_logit.chunks_exact(width)).zip(scenes) {
                rows.all()[part].add_gradient(readouts, by_logit, to);
            }
        }
        gradient
    }
}

impl DrawLogits {
    /// Computes the logits from the read-outs `[B, 16, N_READOUTS]` on their device.
    pub fn new(draws: &[&ActionRows], readouts: &Tensor<3>) -> Self {
        let widths = widths(draws);
        let [first, blocks, second] = std::array::from_fn(|part| {
            let rows: Vec<&Row> = draws.iter().map(|rows| rows.all()[part]).collect();
            logits_of(&rows, widths[part], readouts)
        });
        Self { first, blocks, second }
    }
}

/// Gathers the read-outs of all terms, and the products of query and keys, for rows that share the query's position.
fn logits_of(rows: &[&Row], width: usize, readouts: &Tensor<3>) -> Tensor<2> {
    let (b, device) = (rows.len(), readouts.device());
    let n_terms = rows.iter().flat_map(|row| row.each().map(|(_, terms)| terms.len())).max().unwrap_or(0).max(1);
    let mut indices = vec![0_i32; b * width * n_terms];
    let mut coefficients = vec![0.0_f32; b * width * n_terms];
    let mut partners = vec![0_i32; b * width];
    let mut roots = vec![0.0_f32; b * width];
    let mut masks = vec![MASKED_LOGIT; b * width];
    for (i, row) in rows.iter().enumerate() {
        for (k, (option, terms)) in row.each().enumerate() {
            let at = i * width + k;
            masks[at] = 0.0;
            if let Some(partner) = option.partner {
                (partners[at], roots[at]) = (partner.into(), ROOT);
            }
            for (t, &(readout, coefficient)) in terms.iter().enumerate() {
                indices[at * n_terms + t] = readout.into();
                coefficients[at * n_terms + t] = coefficient;
            }
        }
    }
    let floats = |values: Vec<f32>, columns| Tensor::<2>::from_data(TensorData::new(values, [b, columns]), &device);
    let ints = |values: Vec<i32>, columns| Tensor::<2, Int>::from_data(TensorData::new(values, [b, columns]), &device);
    let blocks: Vec<i32> = rows.iter().enumerate().map(|(i, row)| (i * N + row.block) as i32).collect();
    let blocks = Tensor::<1, Int>::from_data(TensorData::new(blocks, [b]), &device);
    let own = readouts.clone().reshape([b * N, N_READOUTS]).select(0, blocks);
    let terms = own.clone().gather(1, ints(indices, width * n_terms)) * floats(coefficients, width * n_terms);
    let linear = terms.reshape([b, width, n_terms]).sum_dim(2).squeeze_dim::<2>(2);
    let query = rows.iter().find(|row| !row.is_empty()).map_or(0, |row| row.query);
    let queries = own.narrow(1, query, D).reshape([b, D, 1]);
    let products = readouts.clone().narrow(2, query + D, D).matmul(queries).squeeze_dim::<2>(2);
    let products = products.gather(1, ints(partners, width)) * floats(roots, width);
    linear + products + floats(masks, width)
}

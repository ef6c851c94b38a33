//! Distances of a policy from the expert's labels and from another policy, on tensors.

use blueprints::N_BLOCKS;
use burn::tensor::{Device, Tensor, TensorData, activation};
use proto::Label;

use crate::network::{MoveTensors, NetworkOutput};

/// Entries of a move.
const MOVE: usize = 6;

/// Labels of a batch of B scenes on a device, with G grippers.
#[derive(Clone, Debug)]
pub struct LabelTensors {
    /// One-hot of each gripper's block `[B, G, 16]`.
    pub choices: Tensor<3>,
    /// Moves of the labeled blocks, zeros for the others `[B, 16, 6]`.
    pub moves: Tensor<3>,
    /// 1 for labeled blocks `[B, 16]`.
    pub labeled: Tensor<2>,
}

/// Loss by part, one value per scene.
#[derive(Clone, Debug)]
pub struct ImitationTensors {
    /// Σ over grippers of the cross-entropy of the block choice, nats, `[B]`.
    pub blocks: Tensor<1>,
    /// Σ over labeled blocks of the mean smooth L1 distance between mean move and label, `[B]`. A block that both
    /// grippers hold counts once, because it moves once.
    pub moves: Tensor<1>,
    /// Σ over labeled blocks of the mean over entries of `ln σ + (μ − label)² / 2σ²` with the mean move μ held fixed,
    /// nats without the constant, `[B]`.
    pub scales: Tensor<1>,
}

impl LabelTensors {
    /// Copies labels to a device.
    pub fn new(labels: &[Label], n_grippers: usize, device: &Device) -> Self {
        let b = labels.len();
        let mut choices = vec![0.0_f32; b * n_grippers * N_BLOCKS];
        let mut moves = vec![0.0_f32; b * N_BLOCKS * MOVE];
        let mut labeled = vec![0.0_f32; b * N_BLOCKS];
        for (row, label) in labels.iter().enumerate() {
            for (gripper, (choice, entries)) in label.choices.iter().zip(&label.moves).take(n_grippers).enumerate() {
                let Some(block) = choice else { continue };
                choices[(row * n_grippers + gripper) * N_BLOCKS + block.get()] = 1.0;
                let at = row * N_BLOCKS + block.get();
                labeled[at] = 1.0;
                moves[at * MOVE..(at + 1) * MOVE].copy_from_slice(entries);
            }
        }
        Self {
            choices: Tensor::from_data(TensorData::new(choices, [b, n_grippers, N_BLOCKS]), device),
            moves: Tensor::from_data(TensorData::new(moves, [b, N_BLOCKS, MOVE]), device),
            labeled: Tensor::from_data(TensorData::new(labeled, [b, N_BLOCKS]), device),
        }
    }
}

/// Returns the loss of the network's distribution against labels. Move errors are squared below `delta` and linear
/// above.
pub fn imitation(output: &NetworkOutput, labels: &LabelTensors, delta: f32) -> ImitationTensors {
    let log_probs = activation::log_softmax(output.logits.clone(), 2) * labels.choices.clone();
    let blocks = log_probs.flatten::<2>(1, 2).sum_dim(1).squeeze_dim(1).neg();
    let MoveTensors { locs, scales } = output.gaussians();
    let error = (locs.clone() - labels.moves.clone()).abs();
    // With c = min(|e|, δ): c²/(2δ) + |e| − c is e²/(2δ) inside and |e| − δ/2 outside, without a branch.
    let inside = error.clone().clamp_max(delta);
    let smooth = inside.clone().powi_scalar(2).div_scalar(2.0 * delta) + error - inside;
    let by_block = |entries: Tensor<3>| {
        let by_block = entries.mean_dim(2).squeeze_dim::<2>(2) * labels.labeled.clone();
        by_block.sum_dim(1).squeeze_dim(1)
    };
    let z = (locs.clone().detach() - labels.moves.clone()) / scales.clone();
    let likelihood = z.powi_scalar(2).mul_scalar(0.5) + scales.clone().log();
    ImitationTensors { blocks, moves: by_block(smooth), scales: by_block(likelihood) }
}

/// Returns KL(`reference` ‖ `output`) of the block choices, plus that of each block's move, weighted by the probability
/// that the reference chooses the block, nats, `[B]`.
///
/// # Shapes
/// Both outputs are of the same scenes. `reference` should be detached from the graph.
pub fn divergence(reference: &NetworkOutput, output: &NetworkOutput) -> Tensor<1> {
    let log_p = activation::log_softmax(reference.logits.clone(), 2);
    let p = log_p.clone().exp();
    let choice = p.clone() * (log_p - activation::log_softmax(output.logits.clone(), 2));
    let [b, g, n] = p.dims();
    // 1 − Π_g (1 − p_g): the probability that some gripper chooses the block.
    let nobody = (0..g)
        .map(|k| p.clone().slice([0..b, k..k + 1, 0..n]).squeeze_dim::<2>(1).neg().add_scalar(1.0))
        .reduce(|a, b| a * b)
        .expect("there is at least one gripper");
    let chosen = nobody.neg().add_scalar(1.0);
    let (p, q) = (reference.gaussians(), output.gaussians());
    let (s, t) = (p.scales.clone(), q.scales.clone());
    // ln(t/s) + (s² + (μ − ν)²) / 2t² − ½ per entry.
    let distance = (s.clone().powi_scalar(2) + (p.locs.clone() - q.locs.clone()).powi_scalar(2))
        / t.clone().powi_scalar(2).mul_scalar(2.0);
    let by_block = (t.log() - s.log() + distance).sub_scalar(0.5).sum_dim(2).squeeze_dim::<2>(2);
    choice.flatten::<2>(1, 2).sum_dim(1).squeeze_dim(1) + (by_block * chosen).sum_dim(1).squeeze_dim(1)
}

#[cfg(test)]
mod tests {
    use blueprints::BlockIdx;

    use super::*;

    #[test]
    fn hand_worked_losses() {
        let device = Device::flex();
        let tensor =
            |values: Vec<f32>, shape: [usize; 3]| Tensor::<3>::from_data(TensorData::new(values, shape), &device);
        // Gripper 0: the logit of block 2 is ln 3 above all others. Gripper 1: all logits are equal.
        let mut logits = vec![0.0; 2 * 2 * N_BLOCKS];
        for row in 0..2 {
            logits[row * 2 * N_BLOCKS + 2] = 3.0_f32.ln();
        }
        let mut locs = vec![0.0; 2 * N_BLOCKS * MOVE];
        locs[2 * MOVE] = 0.5;
        locs[2 * MOVE + 1] = 0.05;
        locs[(N_BLOCKS + 2) * MOVE] = 0.3;
        let output = NetworkOutput {
            logits: tensor(logits, [2, 2, N_BLOCKS]),
            moves: Some(MoveTensors {
                locs: tensor(locs, [2, N_BLOCKS, MOVE]),
                scales: tensor(vec![1.0; 2 * N_BLOCKS * MOVE], [2, N_BLOCKS, MOVE]),
            }),
            values: Tensor::from_data(TensorData::new(vec![0.0_f32; 2], [2]), &device),
            readouts: None,
            draws: None,
        };
        let block = |index: u8| BlockIdx::try_from(index).ok();
        let apart = Label { choices: [block(2), block(7)], moves: [[0.0; 6], [0.6, 0.0, 0.0, 0.0, 0.0, 0.0]] };
        let together = Label { choices: [block(2); 2], moves: [[0.3, 0.0, 0.0, 0.0, 0.0, 0.12]; 2] };
        let labels = LabelTensors::new(&[apart, together], 2, &device);
        let loss = imitation(&output, &labels, 0.1);
        let values = |tensor: Tensor<1>| tensor.into_data().try_to_vec::<f32>().unwrap();
        // −ln(3/18) and −ln(1/16).
        let blocks = (18.0_f32 / 3.0).ln() + 16.0_f32.ln();
        // First scene: block 2 is off by 0.5 (loss 0.45) and 0.05 (0.0125), block 7 by 0.6 (0.55), over 6 entries each.
        // Second scene: block 2 once, off by 0.12 (0.07). For the scales, ln 1 is 0, leaving half the squared errors,
        // 0.25 + 0.0025 + 0.36 and 0.0144, over 6 entries.
        let scales = [0.6125 / 12.0, 0.0144 / 12.0];
        let losses = [(loss.blocks, [blocks; 2]), (loss.moves, [1.0125 / 6.0, 0.07 / 6.0]), (loss.scales, scales)];
        for (found, expected) in losses {
            for (found, expected) in values(found).into_iter().zip(expected) {
                assert!((found - expected).abs() < 1e-5, "{found} {expected}");
            }
        }
    }

    #[test]
    fn a_hand_worked_divergence() {
        let device = Device::flex();
        let tensor =
            |values: Vec<f32>, shape: [usize; 3]| Tensor::<3>::from_data(TensorData::new(values, shape), &device);
        // The reference is certain of block 3; the other output gives all blocks the same probability. One entry of
        // block 3's move is off by 0.4, and all deviations are 0.5 instead of 0.25.
        let output = |sure: f32, loc: f32, scale: f32| {
            let mut logits = vec![0.0; N_BLOCKS];
            logits[3] = sure;
            let mut locs = vec![0.0; N_BLOCKS * MOVE];
            locs[3 * MOVE] = loc;
            NetworkOutput {
                logits: tensor(logits, [1, 1, N_BLOCKS]),
                moves: Some(MoveTensors {
                    locs: tensor(locs, [1, N_BLOCKS, MOVE]),
                    scales: tensor(vec![scale; N_BLOCKS * MOVE], [1, N_BLOCKS, MOVE]),
                }),
                values: Tensor::from_data(TensorData::new(vec![0.0_f32], [1]), &device),
                readouts: None,
                draws: None,
            }
        };
        let kl = |a: &NetworkOutput, b: &NetworkOutput| divergence(a, b).into_data().try_to_vec::<f32>().unwrap()[0];
        let reference = output(60.0, 0.4, 0.25);
        assert!(kl(&reference, &reference).abs() < 1e-6);
        // ln 16, plus ln 2 + 0.0625/0.5 − 0.5 for each of the six entries, plus 0.16/0.5 for the entry that is off.
        let expected = 16.0_f32.ln() + 6.0 * (2.0_f32.ln() + 0.125 - 0.5) + 0.32;
        let found = kl(&reference, &output(0.0, 0.0, 0.5));
        assert!((found - expected).abs() < 1e-4, "{found} {expected}");
    }
}

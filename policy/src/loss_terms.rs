//! The action distribution on tensors, for losses; equals [`crate::distribution`].

use blueprints::N_BLOCKS;
use burn::tensor::{Bool, Device, Tensor, TensorData, activation};
use proto::{Action, N_GRIPPERS};

use crate::distribution::{HALF_LN_2PI, MASKED_LOGIT, MOVE};
use crate::mixture::{ActionRows, Row};
use crate::network::{MoveTensors, NetworkOutput};
use crate::proposals::Slot;

/// Actions of a batch of B steps with G grippers, on a device.
#[derive(Clone, Debug)]
pub struct ActionTensors {
    /// One-hot of each gripper's choice `[B, G, 16]`.
    pub choices: Tensor<3>,
    /// Moves `[B, 16, 6]`.
    pub moves: Tensor<3>,
    /// Draws from the mixture head; `None` for the Gaussian head.
    pub draws: Option<DrawTensors>,
}

/// Recorded draws from the mixture head on a device.
#[derive(Clone, Debug)]
pub struct DrawTensors {
    /// One-hot of the first gripper's proposal `[B, K]`.
    pub first: Tensor<2>,
    /// One-hot of the second gripper's proposal `[B, K]`; zeros where it moved nothing of its own.
    pub second: Tensor<2>,
}

/// Entropy by part, in nats, one value per step.
#[derive(Clone, Debug)]
pub struct EntropyTensors {
    /// Σ over grippers of the entropy of the block choice, `[B]`.
    pub blocks: Tensor<1>,
    /// Entropy of the moves of the chosen blocks, expected over the choice, `[B]`.
    pub moves: Tensor<1>,
}

impl ActionTensors {
    /// Copies actions to a device. A missing choice becomes a row of zeros.
    pub fn new<'a>(actions: impl ExactSizeIterator<Item = &'a Action>, n_grippers: usize, device: &Device) -> Self {
        let b = actions.len();
        let mut choices = vec![0.0_f32; b * n_grippers * N_BLOCKS];
        let mut moves: Vec<f32> = Vec::with_capacity(b * N_BLOCKS * MOVE);
        for (action, rows) in actions.zip(choices.chunks_exact_mut(n_grippers * N_BLOCKS)) {
            for (choice, row) in action.choices.iter().zip(rows.chunks_exact_mut(N_BLOCKS)) {
                if let Some(block) = choice {
                    row[block.get()] = 1.0;
                }
            }
            moves.extend(action.moves.iter().flatten());
        }
        Self {
            choices: Tensor::from_data(TensorData::new(choices, [b, n_grippers, N_BLOCKS]), device),
            moves: Tensor::from_data(TensorData::new(moves, [b, N_BLOCKS, MOVE]), device),
            draws: None,
        }
    }

    /// Adds the draws: the slots of each action's proposals, and the rows that offer them.
    pub fn with_draws<'a>(
        self,
        actions: impl ExactSizeIterator<Item = (&'a [Option<Slot>; N_GRIPPERS], &'a ActionRows)>,
        device: &Device,
    ) -> Self {
        let b = actions.len();
        let all: Vec<_> = actions.collect();
        let one_hot = |gripper: usize, row: fn(&ActionRows) -> &Row| {
            let width = all.iter().map(|(_, rows)| row(rows).len()).max().unwrap_or(0).max(1);
            let mut values = vec![0.0_f32; b * width];
            for ((slots, rows), values) in all.iter().zip(values.chunks_exact_mut(width)) {
                if let Some(at) = slots[gripper].and_then(|slot| row(rows).position(slot.index())) {
                    values[at] = 1.0;
                }
            }
            Tensor::<2>::from_data(TensorData::new(values, [b, width]), device)
        };
        let draws = DrawTensors { first: one_hot(0, |rows| &rows.first), second: one_hot(1, |rows| &rows.second) };
        Self { draws: Some(draws), ..self }
    }
}

/// Sets the logits of blocks that may not be chosen to −1e9.
///
/// # Shapes
/// logits `[B, G, 16]`, allowed `[B, 16]`; `None` allows all → `[B, G, 16]`
pub fn mask_logits(logits: Tensor<3>, allowed: &[Option<[bool; N_BLOCKS]>]) -> Tensor<3> {
    if allowed.iter().all(Option::is_none) {
        return logits;
    }
    let [b, g, n] = logits.dims();
    let mut forbidden = Vec::with_capacity(b * g * n);
    for row in allowed {
        let row = row.unwrap_or([true; N_BLOCKS]).map(|allowed| !allowed);
        (0..g).for_each(|_| forbidden.extend(row));
    }
    let mask = Tensor::<3, Bool>::from_data(TensorData::new(forbidden, [b, g, n]), &logits.device());
    logits.mask_fill(mask, MASKED_LOGIT)
}

/// Returns the joint log-probability of the actions.
///
/// # Shapes
/// → `[B]`
pub fn log_prob(output: &NetworkOutput, actions: &ActionTensors) -> Tensor<1> {
    let choice = per_row(activation::log_softmax(block_logits(output), 2) * actions.choices.clone());
    if let (Some(logits), Some(drawn)) = (&output.draws, &actions.draws) {
        let of_draw = |logits: &Tensor<2>, drawn: &Tensor<2>| {
            (activation::log_softmax(logits.clone(), 1) * drawn.clone()).sum_dim(1).squeeze_dim::<1>(1)
        };
        let draws = of_draw(&logits.first, &drawn.first) + of_draw(&logits.second, &drawn.second);
        return choice + draws;
    }
    let MoveTensors { locs, scales } = output.gaussians();
    let z = (actions.moves.clone() - locs.clone()) / scales.clone();
    let density = (z.powi_scalar(2).mul_scalar(-0.5) - scales.clone().log()).sub_scalar(HALF_LN_2PI);
    let by_block = density.sum_dim(2).squeeze_dim::<2>(2);
    let weighted = by_block * counts(&actions.choices).clamp_max(1.0);
    choice + weighted.sum_dim(1).squeeze_dim(1)
}

/// Returns the entropy of the choices, and that of the moves in expectation over the choices.
///
/// With the mixture head, these are the entropies of the choices of blocks and of proposals, each given the recorded
/// `draws` before it. Their mean over drawn actions is that of the joint distribution, without the moves' densities.
///
/// # Shapes
/// → `[B]` each
pub fn entropy(output: &NetworkOutput, draws: Option<&DrawTensors>) -> EntropyTensors {
    let log_probs = activation::log_softmax(block_logits(output), 2);
    let probs = log_probs.clone().exp();
    let blocks = per_row(probs.clone() * log_probs).neg();
    if let (Some(logits), Some(drawn)) = (&output.draws, draws) {
        let of_draw = |logits: &Tensor<2>, drawn: &Tensor<2>| {
            let log_probs = activation::log_softmax(logits.clone(), 1);
            // 0 where nothing was drawn.
            let was_drawn = drawn.clone().sum_dim(1);
            (log_probs.clone().exp() * log_probs * was_drawn).sum_dim(1).squeeze_dim::<1>(1).neg()
        };
        return EntropyTensors {
            blocks,
            moves: of_draw(&logits.first, &drawn.first) + of_draw(&logits.second, &drawn.second),
        };
    }
    let of_move = output.gaussians().scales.clone().log().add_scalar(0.5 + HALF_LN_2PI).sum_dim(2).squeeze_dim::<2>(2);
    let [b, g, n] = probs.dims();
    // 1 − Π_g (1 − p_g): the probability that some gripper chooses the block.
    let nobody = (0..g)
        .map(|k| probs.clone().slice([0..b, k..k + 1, 0..n]).squeeze_dim::<2>(1).neg().add_scalar(1.0))
        .reduce(|a, b| a * b)
        .expect("there is at least one gripper");
    let weighted = of_move * nobody.neg().add_scalar(1.0);
    EntropyTensors { blocks, moves: weighted.sum_dim(1).squeeze_dim(1) }
}

/// Returns the logits of the blocks `[B, G, 16]`; with the mixture head, the second gripper's are those given the first
/// one's recorded draw.
fn block_logits(output: &NetworkOutput) -> Tensor<3> {
    let logits = output.logits.clone();
    let [b, n_grippers, n] = logits.dims();
    match &output.draws {
        Some(draws) if n_grippers > 1 => {
            let first = logits.clone().narrow(1, 0, 1);
            let second = logits.narrow(1, 1, 1);
            Tensor::cat(vec![first, second + draws.blocks.clone().reshape([b, 1, n])], 1)
        }
        _ => logits,
    }
}

/// Sums over grippers: `[B, G, 16]` → `[B, 16]`.
fn counts(choices: &Tensor<3>) -> Tensor<2> {
    choices.clone().sum_dim(1).squeeze_dim(1)
}

/// Sums over everything except the batch: `[B, G, 16]` → `[B]`.
fn per_row(x: Tensor<3>) -> Tensor<1> {
    x.flatten::<2>(1, 2).sum_dim(1).squeeze_dim(1)
}

//! Forward passes through the network, with and without gradients.

use std::ops::AddAssign;

use blueprints::N_BLOCKS;
use burn::tensor::{Device, Tensor, TensorData};
use policy::cpu::Outputs;
use policy::distribution::mask_logits;
use policy::loss_terms::{self, ActionTensors};
use policy::mixture::{ActionRows, MixtureDistribution, N_READOUTS};
use policy::{Engine, FeatureBatch, MoveTensors, NetworkOutput, PolicyConfig};

use crate::batch::Batch;
use crate::config::LossConfig;
use crate::draws::Draws;
use crate::loss::{policy_loss, value_loss};

/// The networks of one thread.
#[derive(Debug)]
pub(super) struct Passes {
    policy: PolicyConfig,
    device: Device,
    tracked_device: Device,
    pub(super) engine: Engine,
}

/// The network's output for rows of a batch, without gradients.
#[derive(Default)]
pub(super) struct Evaluation {
    /// Normalized values of all rows.
    pub(super) values: Vec<f32>,
    /// Log-probabilities of the samples' actions.
    pub(super) log_probs: Vec<f32>,
    /// Entropies of the samples' draws from the mixture head; empty for the Gaussian head.
    pub(super) entropies: Vec<[f32; 3]>,
}

/// The targets of the loss; the vectors have one entry per sample.
pub(super) struct Targets<'a> {
    /// The loss, after this many environment steps.
    pub(super) loss: &'a LossConfig,
    pub(super) n_env_steps: u64,
    /// Reference log-probabilities for the ratio.
    pub(super) reference: &'a [f32],
    /// Weights of the samples in the policy loss.
    pub(super) weights: Vec<f32>,
    /// Normalized advantages.
    pub(super) advantages: Vec<f32>,
    /// Returns, normalized.
    pub(super) value_targets: Vec<f32>,
}

impl Targets<'_> {
    /// The weights of the entropies of blocks and of moves.
    fn entropy_weights(&self) -> [f32; 2] {
        [&self.loss.block_entropy, &self.loss.move_entropy].map(|schedule| schedule.at(self.n_env_steps))
    }
}

/// Result of a forward and backward pass.
pub(super) struct GradientPass {
    /// Gradient of the loss, in the order of the flat parameters.
    pub(super) gradient: Vec<f32>,
    /// Log-probabilities of the samples' actions, before the step.
    pub(super) log_probs: Vec<f32>,
    /// Sums over the samples.
    pub(super) losses: LossSums,
}

/// Sums of the loss terms over samples.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LossSums {
    pub(super) policy: f64,
    pub(super) value: f64,
    pub(super) blocks: f64,
    pub(super) moves: f64,
}

impl LossSums {
    /// Returns the weighted sum that is minimized.
    pub(super) fn total(&self, targets: &Targets<'_>) -> f64 {
        let weighted = |coefficient: f32, sum: f64| f64::from(coefficient) * sum;
        let [block_entropy, move_entropy] = targets.entropy_weights();
        let entropies = weighted(block_entropy, self.blocks) + weighted(move_entropy, self.moves);
        self.policy - entropies + weighted(targets.loss.vf_coef, self.value)
    }
}

impl AddAssign for LossSums {
    fn add_assign(&mut self, other: Self) {
        self.policy += other.policy;
        self.value += other.value;
        self.blocks += other.blocks;
        self.moves += other.moves;
    }
}

impl Passes {
    /// Creates a network with the initial parameters of `seed`.
    pub(super) fn new(policy: &PolicyConfig, seed: u64, device: &Device) -> Self {
        Self {
            policy: policy.clone(),
            device: device.clone(),
            tracked_device: device.clone().autodiff(),
            engine: Engine::new(policy, seed, device, true),
        }
    }

    /// Computes the values of `rows` and, for rows that are samples, the log-probabilities of their actions. `rows`
    /// must be ascending.
    pub(super) fn evaluate(&mut self, batch: &Batch, rows: &[usize]) -> Evaluation {
        let outputs = self.engine.run(&batch.features, rows);
        // Samples come first in a batch, so the samples in `rows` are a prefix.
        let samples = &rows[..rows.partition_point(|&row| row < batch.n_samples())];
        let (log_probs, entropies) = match &batch.draws {
            _ if samples.is_empty() => Default::default(),
            Some(draws) => self.evaluate_draws(batch, draws, samples, &outputs),
            None => {
                let actions = self.actions(batch, samples, &self.device);
                let n_grippers = usize::from(self.policy.features.n_grippers);
                let mut output = head_of(&outputs.to_tensors(n_grippers, &self.device), samples.len());
                self.mask(&mut output, &batch.features, samples);
                (to_vec(loss_terms::log_prob(&output, &actions)), Vec::new())
            }
        };
        Evaluation { values: outputs.values, log_probs, entropies }
    }

    /// Computes the gradient of `share` × the summed loss of `samples`.
    pub(super) fn gradient(
        &mut self,
        batch: &Batch,
        samples: &[usize],
        targets: &Targets<'_>,
        share: f32,
        spare: Vec<f32>,
    ) -> GradientPass {
        let draws: Vec<&ActionRows> = match &batch.draws {
            Some(draws) => samples.iter().map(|&sample| &draws[sample].rows).collect(),
            None => Vec::new(),
        };
        let (mut output, leaves) = self.engine.run_tracked(&batch.features, samples, &draws);
        self.mask(&mut output, &batch.features, samples);
        let (config, device) = (targets.loss, &self.tracked_device);
        let [block_entropy, move_entropy] = targets.entropy_weights();
        let values = std::mem::replace(&mut output.values, Tensor::zeros([0], device));
        let column = |values: &[f32]| {
            let values: Vec<f32> = samples.iter().map(|&sample| values[sample]).collect();
            Tensor::<1>::from_data(TensorData::new(values, [samples.len()]), device)
        };
        let actions = self.actions(batch, samples, device);
        let log_prob = loss_terms::log_prob(&output, &actions);
        let (weight, advantage) = (column(&targets.weights), column(&targets.advantages));
        let policy =
            policy_loss(log_prob.clone(), column(targets.reference), weight, advantage, config.clip_range).sum();
        let entropy = loss_terms::entropy(&output, actions.draws.as_ref());
        let (blocks, moves) = (entropy.blocks.sum(), entropy.moves.sum());
        let value = value_loss(values, column(&targets.value_targets)).sum();
        let entropies = blocks.clone() * block_entropy + moves.clone() * move_entropy;
        let loss = value.clone() * config.vf_coef + (policy.clone() - entropies);
        let parts = vec![policy, value, blocks, moves];
        let gradient = self.engine.gradient(leaves, &(loss * share), &draws, spare);
        let sums = to_vec(Tensor::cat(parts, 0));
        let sum = |i: usize| sums.get(i).copied().map_or(f64::NAN, f64::from);
        let losses = LossSums { policy: sum(0), value: sum(1), blocks: sum(2), moves: sum(3) };
        GradientPass { gradient, log_probs: to_vec(log_prob), losses }
    }

    /// Masks the logits as configured.
    fn mask(&self, output: &mut NetworkOutput, features: &FeatureBatch, rows: &[usize]) {
        let allowed: Vec<_> = rows.iter().map(|&row| self.policy.choosable(features, row)).collect();
        output.logits = loss_terms::mask_logits(output.logits.clone(), &allowed);
    }

    fn actions(&self, batch: &Batch, samples: &[usize], device: &Device) -> ActionTensors {
        let n_grippers = usize::from(self.policy.features.n_grippers);
        let actions = ActionTensors::new(samples.iter().map(|&sample| &batch.actions[sample]), n_grippers, device);
        let Some(draws) = &batch.draws else { return actions };
        let drawn = samples.iter().map(|&sample| (&draws[sample].slots, &draws[sample].rows));
        actions.with_draws(drawn, device)
    }

    /// Computes the log-probabilities of samples as the actor did, so that they are equal as long as the weights are,
    /// and the entropies of their draws.
    fn evaluate_draws(
        &self,
        batch: &Batch,
        draws: &[Draws],
        samples: &[usize],
        outputs: &Outputs,
    ) -> (Vec<f32>, Vec<[f32; 3]>) {
        let per_scene = usize::from(self.policy.features.n_grippers) * N_BLOCKS;
        let row = |(at, &sample): (usize, &usize)| {
            let mut logits = outputs.logits[at * per_scene..(at + 1) * per_scene].to_vec();
            if let Some(allowed) = self.policy.choosable(&batch.features, sample) {
                mask_logits(&mut logits, &allowed);
            }
            let distribution = MixtureDistribution {
                logits: &logits,
                readouts: &outputs.readouts[at * N_BLOCKS * N_READOUTS..][..N_BLOCKS * N_READOUTS],
                proposals: &batch.features.proposals[sample],
            };
            let Draws { slots, rows, .. } = &draws[sample];
            (distribution.log_prob(&batch.actions[sample], slots, rows), distribution.entropies(rows))
        };
        samples.iter().enumerate().map(row).unzip()
    }
}

/// Returns the first `n` rows of an output.
fn head_of(output: &NetworkOutput, n: usize) -> NetworkOutput {
    let rows = |tensor: &Tensor<3>| tensor.clone().narrow(0, 0, n);
    NetworkOutput {
        moves: output.moves.as_ref().map(|moves| MoveTensors { locs: rows(&moves.locs), scales: rows(&moves.scales) }),
        logits: rows(&output.logits),
        values: output.values.clone().narrow(0, 0, n),
        readouts: None,
        draws: None,
    }
}

fn to_vec(tensor: Tensor<1>) -> Vec<f32> {
    tensor.into_data().try_to_vec().expect("all tensors here are f32")
}

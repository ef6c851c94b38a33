//! Passes through the network: one that looks, one that computes gradients.

use std::ops::AddAssign;

use burn::tensor::{Device, Tensor, TensorData};
use policy::config::BlockMask;
use policy::loss_terms::{self, ActionTensors};
use policy::parameters::{self, ParameterError};
use policy::{BatchTensors, FeatureBatch, Network, NetworkOutput, PolicyConfig};

use crate::batch::Batch;
use crate::config::LossTerms;
use crate::loss::{policy_loss, value_loss};

/// Networks for passes on one thread.
#[derive(Debug)]
pub(super) struct Passes {
    policy: PolicyConfig,
    device: Device,
    tracked_device: Device,
    /// On the plain device, for values and log-probabilities.
    plain: Network,
    /// On the differentiating device, for gradients.
    tracked: Network,
}

/// What the network says about rows of a batch, without gradients.
#[derive(Default)]
pub(super) struct Evaluation {
    /// Normalised values of all rows.
    pub(super) values: Vec<f32>,
    /// Log-probabilities of the samples' actions.
    pub(super) log_probs: Vec<f32>,
}

/// What the network is pulled towards, one entry per sample.
pub(super) struct Targets<'a> {
    /// How the parts of the loss weigh.
    pub(super) loss: LossTerms,
    /// Log-probabilities that the ratio is taken against.
    pub(super) reference: &'a [f32],
    /// Weights of the samples in the policy loss.
    pub(super) weights: Vec<f32>,
    /// Normalised advantages.
    pub(super) advantages: Vec<f32>,
    /// Values before the update, normalised.
    pub(super) old_values: Vec<f32>,
    /// Returns, normalised.
    pub(super) value_targets: Vec<f32>,
}

/// Result of a forward and backward pass.
pub(super) struct GradientPass {
    /// Of the loss, in the order of the flat parameters.
    pub(super) gradient: Vec<f32>,
    /// Log-probabilities of the samples' actions, before the step.
    pub(super) log_probs: Vec<f32>,
    /// Sums over the samples.
    pub(super) losses: LossSums,
}

/// Sums of the parts of the loss over samples.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LossSums {
    pub(super) policy: f64,
    pub(super) value: f64,
    pub(super) blocks: f64,
    pub(super) moves: f64,
}

impl LossSums {
    /// The weighted sum that is minimised.
    pub(super) fn total(&self, config: &LossTerms) -> f64 {
        let weighted = |coefficient: f32, sum: f64| f64::from(coefficient) * sum;
        self.policy + weighted(config.value_coefficient, self.value)
            - weighted(config.block_entropy, self.blocks)
            - weighted(config.move_entropy, self.moves)
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
    /// Both networks with the initial parameters of `seed`.
    pub(super) fn new(policy: &PolicyConfig, seed: u64, device: &Device) -> Self {
        let tracked_device = device.clone().autodiff();
        let network = |device| Network::init(&policy.network, &policy.sizes(), seed, device);
        let (plain, tracked) = (network(device), network(&tracked_device));
        Self { policy: policy.clone(), device: device.clone(), tracked_device, plain, tracked }
    }

    /// The network without gradients.
    pub(super) fn network(&self) -> &Network {
        &self.plain
    }

    /// Puts `parameters` into both networks.
    ///
    /// # Errors
    /// When their number is wrong or one is not finite.
    pub(super) fn load(&mut self, parameters: &[f32]) -> Result<(), ParameterError> {
        self.plain = parameters::load(self.plain.clone(), parameters)?;
        self.tracked = parameters::load(self.tracked.clone(), parameters)?;
        Ok(())
    }

    /// Values of `rows` and log-probabilities of the actions of those that are samples; `rows` must ascend.
    pub(super) fn evaluate(&self, batch: &Batch, rows: &[usize]) -> Evaluation {
        let output = self.forward(&self.plain, &self.device, &batch.features.select(rows));
        // Samples come first in a batch, so those of this piece are a prefix of it.
        let n_samples = rows.partition_point(|&row| row < batch.n_samples());
        let log_probs = if n_samples == 0 {
            Vec::new()
        } else {
            let actions = self.actions(batch, &rows[..n_samples], &self.device);
            to_vec(loss_terms::log_prob(&head_of(&output, n_samples), &actions, self.policy.joint_form))
        };
        Evaluation { values: to_vec(output.values), log_probs }
    }

    /// Gradient of `share` × the summed loss of `samples`.
    pub(super) fn gradient(&self, batch: &Batch, samples: &[usize], targets: &Targets<'_>, share: f32) -> GradientPass {
        let (config, device) = (&targets.loss, &self.tracked_device);
        let output = self.forward(&self.tracked, device, &batch.features.select(samples));
        let column = |values: &[f32]| {
            let values: Vec<f32> = samples.iter().map(|&sample| values[sample]).collect();
            Tensor::<1>::from_data(TensorData::new(values, [samples.len()]), device)
        };
        let form = self.policy.joint_form;
        let log_prob = loss_terms::log_prob(&output, &self.actions(batch, samples, device), form);
        let (weight, advantage) = (column(&targets.weights), column(&targets.advantages));
        let policy = policy_loss(log_prob.clone(), column(targets.reference), weight, advantage, config.clip).sum();
        let entropy = loss_terms::entropy(&output, form);
        let (blocks, moves) = (entropy.blocks.sum(), entropy.moves.sum());
        let (old, target) = (column(&targets.old_values), column(&targets.value_targets));
        let value = value_loss(output.values, old, target, config.value_clip).sum();
        let loss = policy.clone() + value.clone() * config.value_coefficient
            - blocks.clone() * config.block_entropy
            - moves.clone() * config.move_entropy;
        let mut gradients = (loss * share).backward();
        let gradient = parameters::flatten_gradients(&self.tracked, &mut gradients);
        let sums = to_vec(Tensor::cat(vec![policy, value, blocks, moves], 0));
        let sum = |i: usize| sums.get(i).copied().map_or(f64::NAN, f64::from);
        let losses = LossSums { policy: sum(0), value: sum(1), blocks: sum(2), moves: sum(3) };
        GradientPass { gradient, log_probs: to_vec(log_prob), losses }
    }

    /// Runs `network` on normalised features and masks the logits as configured.
    fn forward(&self, network: &Network, device: &Device, features: &FeatureBatch) -> NetworkOutput {
        let mut output = network.forward(&BatchTensors::new(features, network.edge_layout(), device));
        if self.policy.mask == BlockMask::Blueprint {
            output.logits = loss_terms::mask_logits(output.logits, &features.allowed);
        }
        output
    }

    fn actions(&self, batch: &Batch, samples: &[usize], device: &Device) -> ActionTensors {
        let n_grippers = usize::from(self.policy.network.n_grippers);
        ActionTensors::new(samples.iter().map(|&sample| &batch.actions[sample]), n_grippers, device)
    }
}

/// The first `n` rows of an output.
fn head_of(output: &NetworkOutput, n: usize) -> NetworkOutput {
    let rows = |tensor: &Tensor<3>| tensor.clone().narrow(0, 0, n);
    NetworkOutput {
        locs: rows(&output.locs),
        scales: rows(&output.scales),
        logits: rows(&output.logits),
        values: output.values.clone().narrow(0, 0, n),
    }
}

fn to_vec(tensor: Tensor<1>) -> Vec<f32> {
    tensor.into_data().try_to_vec().expect("all tensors here are f32")
}

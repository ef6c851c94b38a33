//! One PPO update: advantages, epochs, minibatches, gradient steps.

mod passes;
pub(crate) mod workers;

use std::ops::Range;

use burn::tensor::Device;
use policy::PolicyConfig;
use policy::parameters::{self, ParameterError, ParameterSpec};
use proto::metrics::{PpoMetrics, ProposalMetrics};
use rand::rngs::ChaCha8Rng;
use rand::seq::SliceRandom;

use crate::adam::{Adam, LearningRate, clip_global_norm};
use crate::batch::Batch;
use crate::config::{LearnerConfig, LrSchedule, Objective};
use crate::draws;
use crate::gae;
use crate::loss::{RatioStatistics, behavior_weights, effective_sample_size, explained_variance, importance_ratios};
use crate::normalization::ValueStatistics;
use crate::state::LearnerState;
use passes::{LossSums, Targets};
use workers::{Workers, pieces};

/// Maximum number of samples for estimating the KL divergence of an update.
const KL_SAMPLES: usize = 2048;

/// The trained network and its optimizer.
#[derive(Debug)]
pub(crate) struct Ppo {
    workers: Workers,
    /// The parameters of the workers' networks, flat.
    parameters: Vec<f32>,
    adam: Adam,
    value_head: ValueHead,
}

/// What gradient steps change: the parameters and the optimizer.
pub(crate) type Trained = (Vec<f32>, Adam);

/// The metrics of an update.
#[derive(Debug)]
pub(crate) struct Learned {
    pub(crate) ppo: PpoMetrics,
    /// `None` for the Gaussian head, and without samples.
    pub(crate) proposals: Option<ProposalMetrics>,
}

/// Positions of the value head in the flat vector.
#[derive(Clone, Debug)]
struct ValueHead {
    /// Range of its last layer's weights.
    weights: Range<usize>,
    bias: usize,
}

/// Sums over the gradient steps of an update.
#[derive(Default)]
struct Steps {
    losses: LossSums,
    n_samples: usize,
    grad_norm: f64,
    n_steps: u64,
    n_skipped: u64,
}

impl Steps {
    /// The means of what the steps counted; all else is zero.
    fn metrics(&self, targets: &Targets<'_>) -> PpoMetrics {
        let mean = |sum: f64| sum / self.n_samples.max(1) as f64;
        PpoMetrics {
            total_loss: mean(self.losses.total(targets)),
            policy_loss: mean(self.losses.policy),
            value_loss: mean(self.losses.value),
            entropy: mean(self.losses.blocks + self.losses.moves),
            entropy_blocks: mean(self.losses.blocks),
            entropy_moves: mean(self.losses.moves),
            grad_norm: self.grad_norm / self.n_steps.max(1) as f64,
            n_gradient_steps: self.n_steps,
            n_skipped_steps: self.n_skipped,
            ..PpoMetrics::default()
        }
    }
}

impl Ppo {
    /// Creates an untrained network that `n_threads` threads evaluate.
    pub(crate) fn new(policy: &PolicyConfig, seed: u64, device: &Device, n_threads: usize) -> Self {
        let workers = Workers::new(policy, seed, device, n_threads);
        let parameters = workers.engine().parameters();
        let adam = Adam::new(parameters.len());
        let value_head = ValueHead::find(workers.engine().table());
        Self { workers, parameters, adam, value_head }
    }

    /// Restores the parameters and moments from a checkpoint, or those before an update.
    pub(crate) fn restore(&mut self, parameters: Vec<f32>, adam: Adam) -> Result<(), ParameterError> {
        self.workers.load(&parameters)?;
        self.parameters = parameters;
        self.adam = adam;
        Ok(())
    }

    /// Returns a copy, for a checkpoint, or so that an update can be taken back.
    pub(crate) fn trained(&self) -> Trained {
        (self.parameters.clone(), self.adam.clone())
    }

    /// Returns the parameters, flat.
    pub(crate) fn parameters(&self) -> &[f32] {
        &self.parameters
    }

    /// Returns the names and shapes of the parameters.
    pub(crate) fn table(&self) -> &[ParameterSpec] {
        self.workers.engine().table()
    }

    /// Runs one update on a batch with normalized features, from which it removes what it [refuses](Batch::refuse). Of
    /// the state, it changes the generator, the learning rate, and the statistics of the value targets.
    pub(crate) fn update(&mut self, batch: &mut Batch, config: &LearnerConfig, state: &mut LearnerState) -> Learned {
        match &config.optimizer.lr_schedule {
            // A resumed run may have been given another rate.
            LrSchedule::Fixed(_) => state.learning_rate.0 = config.optimizer.learning_rate,
            LrSchedule::Line(line) => state.learning_rate.0 = line.points.at(state.n_env_steps),
            LrSchedule::Adaptive(_) => {}
        }
        if batch.n_samples() == 0 {
            let ppo = PpoMetrics { learning_rate: f64::from(state.learning_rate.0), ..PpoMetrics::default() };
            return Learned { ppo, proposals: None };
        }
        let mut before = self.workers.evaluate(batch);
        if batch.refuse(&before.values, &before.log_probs) > 0 {
            before = self.workers.evaluate(batch);
        }
        let batch = &*batch;
        let ratios = importance_ratios(&before.log_probs, &batch.behavior_log_probs);
        let estimator = config.estimator();
        let values = in_reward_units(&before.values, &state.values);
        let advantages = batch.advantages(&*estimator, &values, &ratios);
        let returns: Vec<f32> = advantages.iter().zip(&values).map(|(a, v)| a + v).collect();
        if config.normalization.values && returns.iter().all(|x| x.is_finite()) {
            let next = state.values.after(&returns);
            self.rescale_value_head(&state.values, &next);
            state.values = next;
        }
        let (reference, weights) = match config.loss.objective {
            Objective::Standard => (&batch.behavior_log_probs, vec![1.0; batch.n_samples()]),
            Objective::Decoupled => (&before.log_probs, behavior_weights(&ratios)),
        };
        let mut targets = Targets {
            loss: &config.loss,
            n_env_steps: state.n_env_steps,
            reference,
            weights,
            advantages: Vec::new(),
            value_targets: Vec::new(),
        };
        targets.refresh(advantages, &values, &state.values);

        let mut steps = Steps::default();
        let mut moved = RatioStatistics::default();
        let rate = state.learning_rate;
        for epoch in 0..config.n_epochs {
            if epoch > 0 {
                // The critic has changed, so recompute the stale advantages (Andrychowicz et al., "What matters in
                // on-policy reinforcement learning", section 3.5).
                let values = in_reward_units(&self.workers.values(batch), &state.values);
                let advantages = batch.advantages(&*estimator, &values, &ratios);
                targets.refresh(advantages, &values, &state.values);
            }
            moved = self.epoch(batch, config, &targets, rate, &mut state.rng.0, &mut steps);
        }
        moved.approx_kl = self.divergence(batch, targets.reference, config);
        if let LrSchedule::Adaptive(rule) = &config.optimizer.lr_schedule {
            state.learning_rate = rate.adapted(moved.approx_kl as f32, rule);
        }
        let ppo = PpoMetrics {
            approx_kl: moved.approx_kl,
            clip_fraction: moved.clip_fraction,
            effective_sample_size: effective_sample_size(&before.log_probs, &batch.behavior_log_probs),
            explained_variance: explained_variance(&values[..batch.n_samples()], &returns),
            learning_rate: f64::from(rate.0),
            n_samples: batch.n_samples() as u64,
            n_epochs: config.n_epochs as u64,
            value_mean: state.values.mean,
            value_std: state.values.std,
            ..steps.metrics(&targets)
        };
        let proposals = batch.draws.as_ref().map(|draws| draws::metrics(draws, &before.entropies));
        Learned { ppo, proposals }
    }

    /// Runs one epoch over all samples in random order.
    #[allow(clippy::too_many_arguments, reason = "an update in pieces")]
    fn epoch(
        &mut self,
        batch: &Batch,
        config: &LearnerConfig,
        targets: &Targets<'_>,
        rate: LearningRate,
        rng: &mut ChaCha8Rng,
        steps: &mut Steps,
    ) -> RatioStatistics {
        let n_samples = batch.n_samples();
        let mut order: Vec<usize> = (0..n_samples).collect();
        order.shuffle(rng);
        let mut log_probs = vec![0.0; n_samples];
        for minibatch in pieces(&order, config.minibatch_size) {
            let mut pass = self.workers.gradient(batch, minibatch, targets);
            pass.log_probs.iter().zip(minibatch).for_each(|(&log_prob, &sample)| log_probs[sample] = log_prob);
            if self.step(&mut pass.gradient, rate, config, steps) {
                steps.losses += pass.losses;
                steps.n_samples += minibatch.len();
            }
            self.workers.reuse(pass.gradient);
        }
        RatioStatistics::new(&log_probs, targets.reference, config.loss.clip_range)
    }

    /// Estimates KL(reference ‖ policy) for the current policy from evenly spaced samples, nats.
    fn divergence(&mut self, batch: &Batch, reference: &[f32], config: &LearnerConfig) -> f64 {
        let n_samples = batch.n_samples();
        let rows: Vec<usize> = (0..n_samples).step_by(n_samples.div_ceil(KL_SAMPLES).max(1)).collect();
        let log_probs = self.workers.log_probs(batch, &rows);
        let reference: Vec<f32> = rows.iter().map(|&row| reference[row]).collect();
        RatioStatistics::new(&log_probs, &reference, config.loss.clip_range).approx_kl
    }

    /// Takes one gradient step, unless the gradient is not finite; returns whether it was taken.
    fn step(&mut self, gradient: &mut [f32], rate: LearningRate, config: &LearnerConfig, steps: &mut Steps) -> bool {
        let norm = clip_global_norm(gradient, config.optimizer.max_grad_norm);
        if !norm.is_finite() {
            // A single gradient that is not finite would corrupt the moments permanently.
            tracing::warn!(norm, "a gradient is not finite, skipping its step");
            steps.n_skipped += 1;
            return false;
        }
        steps.grad_norm += f64::from(norm);
        steps.n_steps += 1;
        self.adam.step(&mut self.parameters, gradient, rate);
        self.load();
        true
    }

    fn rescale_value_head(&mut self, from: &ValueStatistics, to: &ValueStatistics) {
        let mut bias = self.parameters[self.value_head.bias];
        from.rescale_head(to, &mut self.parameters[self.value_head.weights.clone()], &mut bias);
        self.parameters[self.value_head.bias] = bias;
        self.load();
    }

    /// Loads the flat parameters into the networks, unless they have overflown: the learner takes such an update back.
    fn load(&mut self) {
        if let Err(error) = self.workers.load(&self.parameters) {
            tracing::debug!(%error, "the parameters are of no use");
        }
    }
}

impl ValueHead {
    /// Finds the last kernel named `value.mlp.*`, and its bias.
    fn find(table: &[ParameterSpec]) -> Self {
        let mut found = Self { weights: 0..0, bias: 0 };
        for (spec, span) in parameters::spans(table).filter(|(spec, _)| spec.name.starts_with("value.mlp.")) {
            if spec.name.ends_with(".w") {
                found.weights = span;
            } else {
                found.bias = span.start;
            }
        }
        found
    }
}

impl Targets<'_> {
    /// Takes new advantages, and the `values` that they were estimated with, both in reward units.
    fn refresh(&mut self, mut advantages: Vec<f32>, values: &[f32], statistics: &ValueStatistics) {
        let returns: Vec<f32> = advantages.iter().zip(values).map(|(a, v)| a + v).collect();
        self.value_targets = normalized(&returns, statistics);
        gae::normalize(&mut advantages);
        self.advantages = advantages;
    }
}

fn in_reward_units(values: &[f32], statistics: &ValueStatistics) -> Vec<f32> {
    let (mean, std) = (statistics.mean as f32, statistics.std as f32);
    values.iter().map(|v| std * v + mean).collect()
}

fn normalized(values: &[f32], statistics: &ValueStatistics) -> Vec<f32> {
    let (mean, std) = (statistics.mean as f32, statistics.std as f32);
    values.iter().map(|v| (v - mean) / std).collect()
}

#[cfg(test)]
mod tests {
    use blueprints::Catalog;
    use policy::MoveHead;
    use proto::{Trajectory, WeightsVersion};
    use rand::SeedableRng;

    use super::*;
    use crate::Learner;
    use crate::tests::learning::{bandit, small_setup};

    #[test]
    fn a_segment_without_a_finite_log_probability_is_left_out_and_spoils_nothing() {
        for move_head in [MoveHead::Gaussian, MoveHead::Mixture] {
            let setup = small_setup(1).with_policy(|c| c.network.move_head = move_head);
            let weights = Learner::new(setup.clone()).unwrap().weights();
            let drawn = bandit(&setup, &weights, 128, &mut ChaCha8Rng::seed_from_u64(2));
            let update = |drawn: &[Trajectory]| {
                let mut batch = Batch::new(drawn.to_vec(), WeightsVersion(0), Catalog::builtin(), &setup.policy);
                let mut ppo = Ppo::new(&setup.policy, 1, &setup.device.open().unwrap(), 1);
                let mut state = Learner::new(setup.clone()).unwrap().state;
                let learned = ppo.update(&mut batch, &setup.config, &mut state);
                (learned, batch.n_refused, ppo.parameters)
            };
            let mut spoilt = drawn.clone();
            let mut others = drawn;
            let transition = &mut spoilt[0].transitions[0];
            match move_head {
                // Its density is 0 in f32.
                MoveHead::Gaussian => transition.action.moves = [[1e30; 6]; 16],
                // The moves of the mixture have no density that depends on weights, but its choices do.
                MoveHead::Mixture => transition.scene.blocks[15].position[0] = f32::NAN,
            }
            others.remove(0);
            let (found, expected) = (update(&spoilt), update(&others));
            assert_eq!((found.1, expected.1), (1, 0), "{move_head:?}");
            assert_eq!((found.0.ppo, found.0.proposals), (expected.0.ppo, expected.0.proposals));
            assert!(found.2 == expected.2, "{move_head:?}: as if it had not come");
        }
    }
}

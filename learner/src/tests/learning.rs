//! Updates move the policy and the critic in the right direction.

use std::sync::Arc;

use blueprints::Catalog;
use policy::config::{EncoderConfig, GatConfig};
use policy::device::DeviceKind;
use policy::{NetworkConfig, Policy, PolicyConfig};
use proto::{ActionMode, Agent, EpisodeStats, Observation, RewardTerms, Scene, Status, Trajectory, Valid, Weights};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

use super::fixtures::{blueprint_id, random_trajectory};
use crate::config::{FixedRate, LearnerConfig, LrSchedule, Objective};
use crate::ppo::workers::PIECE_SIZE;
use crate::{Learner, LearnerSetup, Model, UpdateResult};

/// Returns a setup with a network like the paper's, but small enough for tests that take seconds.
pub(crate) fn small_setup(seed: u64) -> LearnerSetup {
    let encoder =
        EncoderConfig::Gat(GatConfig { n_layers: 1, n_heads: 2, head_dim: 16, mlp_hidden: 32, ..Default::default() });
    let network = NetworkConfig { encoder, width: 16, value_hidden: vec![32], ..NetworkConfig::default() };
    let config = LearnerConfig { batch_size: 256, minibatch_size: 64, ..LearnerConfig::default() };
    LearnerSetup {
        config: Valid::new(config).unwrap(),
        policy: Valid::new(PolicyConfig { network, ..PolicyConfig::default() }).unwrap(),
        catalog: Catalog::builtin().clone(),
        tasks: vec![blueprint_id()],
        settings: Default::default(),
        acting: Default::default(),
        seed,
        device: DeviceKind::Cpu,
        init: None,
    }
}

impl LearnerSetup {
    /// Changes settings of the learner.
    pub(crate) fn with(self, change: impl FnOnce(&mut LearnerConfig)) -> Self {
        Self { config: self.config.with(change).unwrap(), ..self }
    }

    /// Changes settings of the policy.
    pub(crate) fn with_policy(self, change: impl FnOnce(&mut PolicyConfig)) -> Self {
        Self { policy: self.policy.with(change).unwrap(), ..self }
    }

    /// Sets a constant learning rate.
    pub(super) fn at_rate(self, learning_rate: f32) -> Self {
        self.with(|c| {
            c.optimizer.learning_rate = learning_rate;
            c.optimizer.lr_schedule = LrSchedule::Fixed(FixedRate {});
        })
    }
}

/// Returns one-step episodes in random scenes with actions from `weights`; the reward is 1 if gripper 0 chooses a goal
/// block.
pub(crate) fn bandit(setup: &LearnerSetup, weights: &Weights, n: usize, rng: &mut ChaCha8Rng) -> Vec<Trajectory> {
    let mut policy = Policy::new(&setup.policy);
    policy.load(weights).unwrap();
    let mut trajectories: Vec<_> = (0..n).map(|_| random_trajectory(1, weights.version.0, rng)).collect();
    let blueprint = setup.catalog.get(&blueprint_id()).unwrap();
    let scenes: Vec<Scene> = trajectories.iter().map(|t| t.transitions[0].scene.clone()).collect();
    let observations: Vec<_> = scenes.iter().map(|scene| Observation { scene, blueprint }).collect();
    let seed = rng.random();
    let rng = |i: usize| {
        let mut rng = ChaCha8Rng::from_seed(seed);
        rng.set_stream(i as u64);
        rng
    };
    let mut rngs: Vec<ChaCha8Rng> = (0..n).map(rng).collect();
    let decisions = policy.act(&observations, &vec![ActionMode::Sampled; n], &mut rngs).unwrap();
    for (trajectory, decision) in trajectories.iter_mut().zip(decisions) {
        let success = decision.action.choices[0].is_some_and(|block| blueprint.contains(block));
        let reward = RewardTerms { connected: f32::from(u8::from(success)), ..RewardTerms::default() };
        let step = &mut trajectory.transitions[0];
        (step.action, step.behavior_log_prob) = (decision.action, decision.log_prob);
        step.proposals = decision.proposals;
        step.reward = reward;
        trajectory.status = if success { Status::Success } else { Status::TimeLimit };
        trajectory.episode_stats = Some(EpisodeStats { success, n_steps: 1, episode_return: reward });
    }
    trajectories
}

pub(super) fn feed(learner: &Learner, trajectories: Vec<Trajectory>) {
    trajectories.into_iter().for_each(|t| learner.mailbox.push_beyond_capacity(t).unwrap());
}

/// Feeds a learner, and returns its next update.
pub(super) fn learn(learner: &mut Learner, trajectories: Vec<Trajectory>) -> UpdateResult {
    feed(learner, trajectories);
    learner.update_from_mailbox().unwrap()
}

/// Returns a learner after one update on `n` episodes.
fn updated(setup: &LearnerSetup, n: usize) -> Learner {
    let mut learner = Learner::new(setup.clone()).unwrap();
    let trajectories = bandit(setup, &learner.weights(), n, &mut ChaCha8Rng::seed_from_u64(3));
    learn(&mut learner, trajectories);
    learner
}

#[test]
fn rewarded_choice_becomes_more_likely() {
    let setup = small_setup(1).at_rate(3e-3);
    let mut learner = Learner::new(setup.clone()).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut rates = Vec::new();
    for _ in 0..12 {
        let trajectories = bandit(&setup, &learner.weights(), 256, &mut rng);
        let metrics = learn(&mut learner, trajectories).metrics;
        assert!((metrics.ppo.effective_sample_size - 1.0).abs() < 1e-3, "{metrics:?}");
        rates.push(metrics.episodes.success.rate);
    }
    // Chance is 2 in 16.
    assert!(rates[0] < 0.3 && rates[11] > 0.8, "{rates:?}");
}

#[test]
fn update_needs_a_full_batch() {
    let setup = small_setup(1);
    let mut learner = Learner::new(setup.clone()).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    feed(&learner, bandit(&setup, &learner.weights(), 255, &mut rng));
    assert!(learner.update_from_mailbox().is_none());
    let last = bandit(&setup, &learner.weights(), 1, &mut rng);
    let metrics = learn(&mut learner, last).metrics;
    assert_eq!((metrics.n_env_steps, metrics.n_updates, metrics.n_episodes), (256, 1, 256));
    assert_eq!(metrics.ppo.n_gradient_steps, 12);
    assert_eq!(metrics.proposals, None, "the Gaussian head has none");
    assert_eq!(learner.weights().version, metrics.weights_version);
}

#[test]
fn weights_depend_on_the_seed_and_not_on_the_number_of_threads() {
    let weights = |seed, n_threads| {
        // Four pieces per minibatch, which three threads cannot share evenly.
        let setup = small_setup(seed).with(|c| {
            (c.batch_size, c.minibatch_size, c.n_threads) = (4 * PIECE_SIZE, 4 * PIECE_SIZE, Some(n_threads));
        });
        updated(&setup, 4 * PIECE_SIZE).weights()
    };
    assert_eq!(weights(1, 1), weights(1, 3));
    assert_ne!(weights(1, 1).parameters, weights(2, 1).parameters);
}

#[test]
fn old_trajectories_raise_lag_and_lower_effective_sample_size() {
    let setup = small_setup(1).at_rate(3e-3);
    let mut learner = Learner::new(setup.clone()).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let first = learner.weights();
    learn(&mut learner, bandit(&setup, &first, 256, &mut rng));
    feed(&learner, bandit(&setup, &first, 128, &mut rng));
    let newer = bandit(&setup, &learner.weights(), 128, &mut rng);
    let metrics = learn(&mut learner, newer).metrics;
    assert_eq!((metrics.policy_lag_mean, metrics.policy_lag_max), (0.5, 1));
    assert_eq!(metrics.policy_lag_histogram, [128, 128]);
    assert!(metrics.ppo.effective_sample_size < 0.999, "{metrics:?}");
}

#[test]
fn gradient_step_that_is_not_finite_is_skipped() {
    let setup = small_setup(1).with(|c| c.loss.objective = Objective::Standard);
    let mut learner = Learner::new(setup.clone()).unwrap();
    let mut trajectories = bandit(&setup, &learner.weights(), 256, &mut ChaCha8Rng::seed_from_u64(3));
    // The lowest admitted log-density makes the ratio overflow.
    trajectories[0].transitions[0].behavior_log_prob = -2000.0;
    let metrics = learn(&mut learner, trajectories).metrics;
    assert!(metrics.ppo.n_skipped_steps > 0);
    assert!(learner.weights().parameters.iter().all(|x| x.is_finite()));
}

#[test]
fn a_learner_starts_from_a_policy_with_other_deviations_but_not_from_another_network() {
    let learner = updated(&small_setup(1), 256);
    let model = Model::from(&learner.checkpoint());
    let setup = LearnerSetup { init: Some(Arc::new(model)), ..small_setup(2) };
    let mut setup = setup.with_policy(|c| c.network.init_std = Some(0.1));
    let started = Learner::new(setup.clone()).unwrap();
    assert_eq!(started.weights().parameters, learner.weights().parameters);
    assert_eq!(started.weights().normalization, learner.weights().normalization);
    assert_eq!((started.version().0, started.n_env_steps()), (0, 0));
    assert!(started.checkpoint().adam.first.iter().all(|moment| *moment == 0.0));
    let other = setup.clone().with_policy(|c| c.network.value_hidden = vec![16]);
    let error = Learner::new(other).unwrap_err().to_string();
    assert!(error.contains("policy.network"), "{error}");
    let mut broken = Model::from(&learner.checkpoint());
    broken.weights.normalization.value_std = f32::INFINITY;
    setup.init = Some(Arc::new(broken));
    let error = Learner::new(setup).unwrap_err().to_string();
    assert!(error.contains("does not fit"), "{error}");
}

#[test]
fn an_update_that_gives_no_usable_weights_is_taken_back() {
    // The first step overflows the network's outputs, or the parameters themselves.
    for learning_rate in [1e5, 1e38] {
        let setup = small_setup(1).at_rate(learning_rate);
        let mut learner = Learner::new(setup.clone()).unwrap();
        let first = learner.weights();
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for n in 1..=2 {
            let trajectories = bandit(&setup, &learner.weights(), 256, &mut rng);
            let UpdateResult { metrics, refused } = learn(&mut learner, trajectories);
            assert!(refused.is_some(), "{learning_rate}: {metrics:?}");
            assert_eq!((metrics.refused_total, metrics.n_updates, metrics.n_env_steps), (n, n, 256 * n));
            assert_eq!(metrics.ppo.total_loss, 0.0, "what was taken back has no loss");
            assert_eq!(Weights { n_env_steps: 0, ..learner.weights() }, Weights { n_env_steps: 0, ..first.clone() });
        }
        let checkpoint = learner.checkpoint();
        assert_eq!((checkpoint.adam.n_steps, checkpoint.state.values), (0, Default::default()));
        // With a rate that it can learn with, it goes on from there.
        let mut resumed = Learner::resume(setup.clone().at_rate(3e-4), checkpoint).unwrap();
        let trajectories = bandit(&setup, &resumed.weights(), 256, &mut rng);
        assert_eq!(learn(&mut resumed, trajectories).refused, None);
    }
}

#[test]
fn an_adaptive_rate_shrinks_when_an_update_is_taken_back() {
    let setup = small_setup(1).with(|c| c.optimizer.learning_rate = 1e5);
    let learner = updated(&setup, 256);
    assert_eq!((learner.n_refused, learner.version().0), (1, 0));
    assert_eq!(learner.checkpoint().state.learning_rate.0, 1e5_f32 / 1.5);
}

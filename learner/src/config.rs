//! All settings of the learner, with units, defaults and valid ranges.

mod curriculum;
mod imitation;
mod loss;
mod reward;
mod schedule;

use proto::setting::{InvalidSetting, Section, Setting, above, above_to, key};
use proto::settings;
use serde::{Deserialize, Serialize};

pub use curriculum::{CurriculumConfig, LearnabilityConfig, PaperConfig, ReverseConfig, UniformConfig, WideningConfig};
pub use imitation::{ImitationConfig, ReplayConfig};
pub use loss::{LossConfig, LossTerms, Objective};
pub use reward::{RewardFactors, RewardsConfig};
pub use schedule::Schedule;

settings! {
    /// Settings of the learner. The defaults are those of published PPO practice on long-horizon manipulation.
    pub struct LearnerConfig in "learner", check mailbox_holds_an_update {
        /// Environment steps that one update consumes.
        pub steps_per_update: usize = 8192, in 256..=1_048_576;
        /// Samples of one gradient step. The minibatches of an epoch are all of one size, so they may be larger by a
        /// part of the remainder.
        pub minibatch_size: usize = 1024,
            where |c| (1..=c.steps_per_update).contains(&c.minibatch_size) => "1..=steps_per_update";
        /// Samples of one pass through the network, which bounds its memory: on a CPU a pass with gradients keeps about
        /// 230 kB of each. A minibatch is split into equal pieces of about this size, which several threads share, and
        /// their gradients are added.
        pub forward_size: usize = 128, in 1..=65536;
        /// Threads that pass pieces through the network; `None` is one for each core, and one with a GPU. Results do
        /// not depend on it.
        pub n_threads: Option<usize> = None, in 1..=256;
        /// Passes over a batch.
        pub n_epochs: usize = 3, in 1..=32;
        /// Discount per step γ.
        pub gamma: f32 = 0.99, in 0.0..=1.0;
        /// GAE's λ.
        pub lambda: f32 = 0.95, in 0.0..=1.0;
        /// What the learner changes in the rewards.
        pub rewards: RewardsConfig;
        /// PPO loss.
        pub loss: LossConfig;
        /// What is learned from the expert's labels; absent, as by default, means nothing, as in the paper.
        pub imitation: Option<ImitationConfig>;
        /// Gradient step.
        pub optimizer: OptimizerConfig;
        /// Statistics of features and value targets.
        pub normalization: NormalizationConfig;
        /// Inbox of trajectories.
        pub mailbox: MailboxConfig;
        /// Which blueprints to train on.
        pub curriculum: CurriculumConfig;
        /// How far from the goal episodes begin; absent, as by default, leaves that to the actors.
        pub reverse: Option<ReverseConfig>;
        /// When to save and how many to keep.
        pub checkpoints: CheckpointConfig;
    }

    /// Adam, its learning rate, and the limits of a step.
    pub struct OptimizerConfig {
        /// Learning rate at the start.
        pub learning_rate: f32 = 3e-4, in above(0.0);
        /// Learning rate of the value head, which can learn faster than a policy that must not change much in one
        /// update; `None` is the rate of the rest.
        pub critic_rate: Option<f32> = None, in above(0.0);
        /// How the learning rate moves.
        pub rate_rule: RateRule;
        /// Adam's ε, outside the square root.
        pub epsilon: f32 = 1e-5, in above(0.0);
        /// Adam's β₁.
        pub beta1: f64 = 0.9, in 0.0..1.0;
        /// Adam's β₂.
        pub beta2: f64 = 0.999, in 0.0..1.0;
        /// Gradients with a larger global norm are scaled to it.
        pub max_grad_norm: f32 = 0.5, in above(0.0);
        /// Ends an update after the epoch whose approximate KL divergence exceeds this; `None` is off.
        pub stop_kl: Option<f32> = None, in above(0.0);
    }

    /// How the learning rate moves from update to update.
    pub enum RateRule = Adaptive {
        /// It stays as it is.
        Fixed,
        /// It follows the KL divergence of the updates.
        Adaptive(AdaptiveRate),
        /// It goes along a line, whatever the learning rate at the start.
        Line(RateLine),
    }

    /// Rule that keeps the policy's change per update in a band.
    pub struct AdaptiveRate {
        /// Below this KL divergence per update the rate grows.
        pub low_kl: f32 = 0.005, in above(0.0);
        /// Above this KL divergence per update the rate shrinks.
        pub high_kl: f32 = 0.02, where |c| c.high_kl > c.low_kl => "above low_kl";
        /// Factor of growth and shrinkage.
        pub factor: f32 = 1.5, in above(1.0);
        /// Lowest rate.
        pub min: f32 = 1e-5, in above(0.0);
        /// Highest rate.
        pub max: f32 = 1e-3, where |c| c.max >= c.min && c.max.is_finite() => "at least min";
    }

    /// Running statistics.
    pub struct NormalizationConfig {
        /// Features are shifted and scaled by their running mean and deviation.
        pub features: bool = true;
        /// Scenes after which the feature statistics no longer move.
        pub feature_samples: u64 = 500_000;
        /// The value head learns normalized targets.
        pub values: bool = true;
        /// Weight of a new batch in the running statistics of the value targets.
        pub value_rate: f64 = 0.1, in above_to(0.0, 1.0);
        /// Smallest deviation of value targets, reward units.
        pub min_value_std: f32 = 0.01, in above(0.0);
    }

    /// The inbox.
    pub struct MailboxConfig {
        /// Steps from which on nothing more is accepted; at least `steps_per_update`.
        pub capacity_steps: usize = 16384;
        /// Trajectories of weights older than this many versions are dropped.
        pub max_policy_lag: u64 = 4, in 0..=1000;
    }

    /// When checkpoints are written.
    pub struct CheckpointConfig {
        /// Updates between two checkpoints.
        pub every_updates: u64 = 50, in 1..;
        /// Newest checkpoints that stay on disk.
        pub keep: usize = 3, in 1..;
    }
}

/// A learning rate that is set by environment steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RateLine {
    /// Environment steps and learning rates, above 0.
    pub points: Schedule,
}

impl Section for RateLine {
    fn validate_at(&self, path: &str) -> Result<(), InvalidSetting> {
        self.points.check_in(&key(path, "points"), &above(0.0))
    }
}

impl LearnerConfig {
    /// The numbers of the loss after `n_env_steps` environment steps.
    pub fn loss_at(&self, n_env_steps: u64) -> LossTerms {
        let terms = self.loss.at(n_env_steps);
        let Some(imitation) = &self.imitation else { return terms };
        let at = |schedule: &Schedule| schedule.at(n_env_steps);
        LossTerms {
            policy: at(&imitation.ppo_weight),
            imitator_kl: at(&imitation.kl_weight),
            value_coefficient: terms.value_coefficient * at(&imitation.value_weight),
            ..terms
        }
    }

    fn mailbox_holds_an_update(&self, path: &str) -> Result<(), InvalidSetting> {
        let capacity = self.mailbox.capacity_steps;
        let key = format_args!("{path}.mailbox.capacity_steps");
        InvalidSetting::check(key, capacity, capacity >= self.steps_per_update, "at least steps_per_update")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_valid_and_survive_serialization() {
        let config = LearnerConfig::default();
        config.validate().unwrap();
        let text = serde_json::to_string(&config).unwrap();
        assert_eq!(serde_json::from_str::<LearnerConfig>(&text).unwrap(), config);
        assert_eq!(serde_json::from_str::<LearnerConfig>("{}").unwrap(), config);
    }

    #[test]
    fn a_value_out_of_range_is_named() {
        type Spoil = fn(&mut LearnerConfig);
        let cases: [(Spoil, &str); 9] = [
            (|c| c.gamma = 1.5, "learner.gamma = 1.5: expected 0..=1"),
            (|c| c.lambda = f32::NAN, "learner.lambda = NaN: expected 0..=1"),
            (|c| c.n_epochs = 0, "learner.n_epochs = 0: expected 1..=32"),
            (|c| c.minibatch_size = 9000, "learner.minibatch_size = 9000: expected 1..=steps_per_update"),
            (|c| c.loss.clip = 0.0, "learner.loss.clip = 0: expected above 0 and at most 1"),
            (|c| c.optimizer.beta1 = 1.0, "learner.optimizer.beta1 = 1: expected at least 0 and below 1"),
            (
                |c| c.mailbox.capacity_steps = 1,
                "learner.mailbox.capacity_steps = 1: expected at least steps_per_update",
            ),
            (|c| c.checkpoints.keep = 0, "learner.checkpoints.keep = 0: expected at least 1"),
            (
                |c| c.optimizer.learning_rate = f32::INFINITY,
                "learner.optimizer.learning_rate = inf: expected above 0 and finite",
            ),
        ];
        for (spoil, message) in cases {
            let mut config = LearnerConfig::default();
            spoil(&mut config);
            assert_eq!(config.validate().unwrap_err().to_string(), message);
        }
    }

    #[test]
    fn an_unknown_field_is_refused() {
        let error = serde_json::from_str::<LearnerConfig>(r#"{"gama": 0.9}"#).unwrap_err().to_string();
        assert!(error.contains("gama"), "{error}");
    }
}

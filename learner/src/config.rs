//! All settings of the learner, with units, defaults and valid ranges.

mod curriculum;
mod imitation;
mod loss;
mod schedule;

use proto::InvalidSetting;
use serde::{Deserialize, Serialize};

pub use curriculum::{CurriculumConfig, LearnabilityConfig, PaperConfig, UniformConfig, WideningConfig};
pub use imitation::{ImitationConfig, ReplayConfig};
pub use loss::{LossConfig, LossTerms, Objective};
pub use schedule::Schedule;

/// Settings of the learner. The defaults are those of published PPO practice on long-horizon manipulation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LearnerConfig {
    /// Environment steps that one update consumes; 256..=1048576, default 8192.
    pub steps_per_update: usize,
    /// Samples of one gradient step; 1..=`steps_per_update`, default 1024. The minibatches of an epoch are all of one
    /// size, so they may be larger by a part of the remainder.
    pub minibatch_size: usize,
    /// Samples of one pass through the network, so that activations stay in the cache; a minibatch is worked in equal
    /// pieces of about this size, by several threads, and their gradients are added; 1..=65536, default 128.
    pub forward_size: usize,
    /// Threads that pass pieces through the network; 1..=256, `None` (default) is one for each core, and one with a GPU.
    /// Results do not depend on it.
    pub n_threads: Option<usize>,
    /// Passes over a batch; 1..=32, default 3.
    pub n_epochs: usize,
    /// Discount per step γ; 0..=1, default 0.99.
    pub gamma: f32,
    /// GAE's λ; 0..=1, default 0.95.
    pub lambda: f32,
    /// PPO loss.
    pub loss: LossConfig,
    /// What is learned from the expert's labels; absent means nothing, as in the paper. Default: absent.
    pub imitation: Option<ImitationConfig>,
    /// Gradient step.
    pub optimizer: OptimizerConfig,
    /// Statistics of features and value targets.
    pub normalization: NormalizationConfig,
    /// Inbox of trajectories.
    pub mailbox: MailboxConfig,
    /// Which blueprints to train on.
    pub curriculum: CurriculumConfig,
    /// When to save and how many to keep.
    pub checkpoints: CheckpointConfig,
}

/// Adam with a learning rate that follows the KL divergence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OptimizerConfig {
    /// Learning rate at the start; above 0, default 3e-4.
    pub learning_rate: f32,
    /// How the learning rate moves.
    pub rate_rule: RateRule,
    /// Adam's ε, outside the square root; above 0, default 1e-5.
    pub epsilon: f32,
    /// Adam's β₁; 0..1, default 0.9.
    pub beta1: f64,
    /// Adam's β₂; 0..1, default 0.999.
    pub beta2: f64,
    /// Gradients with a larger global norm are scaled to it; above 0, default 0.5.
    pub max_grad_norm: f32,
    /// Ends an update after the epoch whose approximate KL divergence exceeds this; above 0; `None` (default) is off.
    pub stop_kl: Option<f32>,
}

/// How the learning rate moves from update to update.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum RateRule {
    /// It stays as it is.
    Fixed,
    /// It follows the KL divergence of the updates.
    Adaptive(AdaptiveRate),
    /// It goes along a line, whatever the learning rate at the start.
    Line(RateLine),
}

/// A learning rate that is set by environment steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RateLine {
    /// Environment steps and learning rates.
    pub points: Schedule,
}

/// Rule that keeps the policy's change per update in a band.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AdaptiveRate {
    /// Below this KL divergence per update the rate grows; default 0.005.
    pub low_kl: f32,
    /// Above this KL divergence per update the rate shrinks; above `low_kl`, default 0.02.
    pub high_kl: f32,
    /// Factor of growth and shrinkage; above 1, default 1.5.
    pub factor: f32,
    /// Lowest rate; above 0, default 1e-5.
    pub min: f32,
    /// Highest rate; at least `min`, default 1e-3.
    pub max: f32,
}

/// Running statistics.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NormalizationConfig {
    /// Features are shifted and scaled by their running mean and deviation; default true.
    pub features: bool,
    /// Scenes after which the feature statistics no longer move; default 500 000.
    pub feature_samples: u64,
    /// The value head learns normalized targets; default true.
    pub values: bool,
    /// Weight of a new batch in the running statistics of the value targets; above 0, at most 1, default 0.1.
    pub value_rate: f64,
    /// Smallest deviation of value targets, reward units; above 0, default 0.01.
    pub min_value_std: f32,
}

/// The inbox.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MailboxConfig {
    /// Steps from which on nothing more is accepted; at least `steps_per_update`, default 16384.
    pub capacity_steps: usize,
    /// Trajectories of weights older than this many versions are dropped; 0..=1000, default 4.
    pub max_policy_lag: u64,
}

/// When checkpoints are written.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CheckpointConfig {
    /// Updates between two checkpoints; at least 1, default 50.
    pub every_updates: u64,
    /// Newest checkpoints that stay on disk; at least 1, default 3.
    pub keep: usize,
}

impl Default for LearnerConfig {
    fn default() -> Self {
        Self {
            steps_per_update: 8192,
            minibatch_size: 1024,
            forward_size: 128,
            n_threads: None,
            n_epochs: 3,
            gamma: 0.99,
            lambda: 0.95,
            loss: LossConfig::default(),
            imitation: None,
            optimizer: OptimizerConfig::default(),
            normalization: NormalizationConfig::default(),
            mailbox: MailboxConfig::default(),
            curriculum: CurriculumConfig::default(),
            checkpoints: CheckpointConfig::default(),
        }
    }
}

impl Default for OptimizerConfig {
    fn default() -> Self {
        Self {
            learning_rate: 3e-4,
            rate_rule: RateRule::default(),
            epsilon: 1e-5,
            beta1: 0.9,
            beta2: 0.999,
            max_grad_norm: 0.5,
            stop_kl: None,
        }
    }
}

impl Default for RateRule {
    fn default() -> Self {
        Self::Adaptive(AdaptiveRate::default())
    }
}

impl Default for AdaptiveRate {
    fn default() -> Self {
        Self { low_kl: 0.005, high_kl: 0.02, factor: 1.5, min: 1e-5, max: 1e-3 }
    }
}

impl Default for NormalizationConfig {
    fn default() -> Self {
        Self { features: true, feature_samples: 500_000, values: true, value_rate: 0.1, min_value_std: 0.01 }
    }
}

impl Default for MailboxConfig {
    fn default() -> Self {
        Self { capacity_steps: 16384, max_policy_lag: 4 }
    }
}

impl Default for CheckpointConfig {
    fn default() -> Self {
        Self { every_updates: 50, keep: 3 }
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

    /// Checks every field against its range.
    ///
    /// # Errors
    /// The first field out of range, with its value and the range.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        let (optimizer, norm) = (&self.optimizer, &self.normalization);
        let int = |value: usize| value as f64;
        check(
            "steps_per_update",
            int(self.steps_per_update),
            (256.0..=1_048_576.0).contains(&int(self.steps_per_update)),
            "256..=1048576",
        )?;
        check(
            "minibatch_size",
            int(self.minibatch_size),
            (1..=self.steps_per_update).contains(&self.minibatch_size),
            "1..=steps_per_update",
        )?;
        check("forward_size", int(self.forward_size), (1..=65536).contains(&self.forward_size), "1..=65536")?;
        if let Some(n) = self.n_threads {
            check("n_threads", int(n), (1..=256).contains(&n), "1..=256")?;
        }
        check("n_epochs", int(self.n_epochs), (1..=32).contains(&self.n_epochs), "1..=32")?;
        check_unit("gamma", self.gamma)?;
        check_unit("lambda", self.lambda)?;
        self.loss.validate()?;
        self.imitation.as_ref().map_or(Ok(()), ImitationConfig::validate)?;
        if let RateRule::Line(line) = &optimizer.rate_rule {
            check("optimizer.rate_rule.points", 0.0, line.is_valid(), "rates above 0 at ascending environment steps")?;
        }
        check_positive("optimizer.learning_rate", optimizer.learning_rate)?;
        check_positive("optimizer.epsilon", optimizer.epsilon)?;
        check_decay("optimizer.beta1", optimizer.beta1)?;
        check_decay("optimizer.beta2", optimizer.beta2)?;
        check_positive("optimizer.max_grad_norm", optimizer.max_grad_norm)?;
        if let Some(kl) = optimizer.stop_kl {
            check_positive("optimizer.stop_kl", kl)?;
        }
        if let RateRule::Adaptive(adaptive) = &optimizer.rate_rule {
            adaptive.validate()?;
        }
        check_positive("normalization.min_value_std", norm.min_value_std)?;
        check(
            "normalization.value_rate",
            norm.value_rate,
            norm.value_rate > 0.0 && norm.value_rate <= 1.0,
            "above 0 and at most 1",
        )?;
        let capacity = self.mailbox.capacity_steps;
        check("mailbox.capacity_steps", int(capacity), capacity >= self.steps_per_update, "at least steps_per_update")?;
        let lag = self.mailbox.max_policy_lag;
        check("mailbox.max_policy_lag", lag as f64, lag <= 1000, "0..=1000")?;
        self.curriculum.validate()?;
        check(
            "checkpoints.every_updates",
            self.checkpoints.every_updates as f64,
            self.checkpoints.every_updates >= 1,
            "at least 1",
        )?;
        check("checkpoints.keep", int(self.checkpoints.keep), self.checkpoints.keep >= 1, "at least 1")
    }
}

impl RateLine {
    fn is_valid(&self) -> bool {
        self.points.is_ordered() && self.points.values().iter().all(|rate| *rate > 0.0 && rate.is_finite())
    }
}

impl AdaptiveRate {
    fn validate(&self) -> Result<(), InvalidSetting> {
        check_positive("optimizer.rate_rule.low_kl", self.low_kl)?;
        check("optimizer.rate_rule.high_kl", self.high_kl.into(), self.high_kl > self.low_kl, "above low_kl")?;
        check(
            "optimizer.rate_rule.factor",
            self.factor.into(),
            self.factor > 1.0 && self.factor.is_finite(),
            "above 1",
        )?;
        check_positive("optimizer.rate_rule.min", self.min)?;
        check("optimizer.rate_rule.max", self.max.into(), self.max >= self.min && self.max.is_finite(), "at least min")
    }
}

/// Turns `ok` into an error that names the field. `NaN` must make `ok` false.
pub(crate) fn check(field: &'static str, value: f64, ok: bool, range: &'static str) -> Result<(), InvalidSetting> {
    InvalidSetting::check(format_args!("learner.{field}"), value, ok, range)
}

fn check_unit(field: &'static str, value: f32) -> Result<(), InvalidSetting> {
    check(field, value.into(), (0.0..=1.0).contains(&value), "0..=1")
}

fn check_decay(field: &'static str, value: f64) -> Result<(), InvalidSetting> {
    check(field, value, (0.0..1.0).contains(&value), "at least 0 and below 1")
}

fn check_positive(field: &'static str, value: f32) -> Result<(), InvalidSetting> {
    check(field, value.into(), value > 0.0 && value.is_finite(), "above 0 and finite")
}

fn check_at_least(field: &'static str, value: f32, low: f32, range: &'static str) -> Result<(), InvalidSetting> {
    check(field, value.into(), value >= low && value.is_finite(), range)
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

//! All settings of the learner, with units, defaults and valid ranges.

mod schedule;

use proto::setting::schema::{self, Schema};
use proto::setting::{InvalidSetting, Section, Setting, above, above_to, key};
use proto::settings;
use serde::{Deserialize, Serialize};

use crate::advantages::Estimator;
use crate::gae::Gae;

pub use schedule::Schedule;

settings! {
    /// Settings of the learner. The defaults follow published PPO practice for long-horizon manipulation.
    pub struct LearnerConfig in "learner", check mailbox_holds_an_update {
        /// Environment steps that one update consumes.
        pub batch_size: usize = 8192, in 256..=1_048_576;
        /// Samples per gradient step. All minibatches of an epoch have about the same size, so each may be larger by a
        /// share of the remainder.
        pub minibatch_size: usize = 1024,
            where |c| (1..=c.batch_size).contains(&c.minibatch_size) => "1..=batch_size";
        /// Threads that pass pieces through the network; absent means one per core on a CPU, or one in total with a
        /// GPU. Results do not depend on the number of threads.
        pub n_threads: Option<usize> = None, in 1..=256;
        /// Passes over each batch.
        pub n_epochs: usize = 3, in 1..=32;
        /// Discount γ per step.
        pub gamma: f32 = 0.99, in 0.0..=1.0;
        /// GAE's λ.
        pub gae_lambda: f32 = 0.95, in 0.0..=1.0;
        /// PPO loss.
        pub loss: LossConfig;
        /// Adam and its learning rate.
        pub optimizer: OptimizerConfig;
        /// Normalization of features and value targets.
        pub normalization: NormalizationConfig;
        /// Queue of incoming trajectories.
        pub mailbox: MailboxConfig;
        /// How training blueprints are drawn as goals.
        pub curriculum: CurriculumConfig;
        /// When to save checkpoints and how many to keep.
        pub checkpoints: CheckpointConfig;
    }

    /// The PPO objective.
    pub struct LossConfig {
        /// Probability ratios beyond 1 ± this are clipped.
        pub clip_range: f32 = 0.2, in above_to(0.0, 1.0);
        /// Weight of the value loss.
        pub vf_coef: f32 = 0.5, in 0.0..;
        /// Weight of the entropy of the block choice, nats. Below 0, it makes the policy decisive, so that greedy
        /// actions match sampled ones.
        pub block_entropy: Schedule = Schedule::Constant(0.005), in -1.0..=1.0;
        /// Weight of the expected entropy of the moves, nats.
        pub move_entropy: Schedule = Schedule::Constant(1e-4), in -1.0..=1.0;
        /// Reference policy of the probability ratio.
        pub objective: Objective = Objective::Decoupled;
    }

    /// Adam, its learning rate, and the limits of a step.
    pub struct OptimizerConfig {
        /// Initial learning rate.
        pub learning_rate: f32 = 3e-4, in above(0.0);
        /// How the learning rate changes.
        pub lr_schedule: LrSchedule;
        /// Gradients with a larger global norm are scaled down to this norm.
        pub max_grad_norm: f32 = 0.5, in above(0.0);
    }

    /// How the learning rate changes from update to update.
    pub enum LrSchedule = Adaptive {
        /// Stays constant.
        Fixed(FixedRate),
        /// Adapts to the KL divergence of the updates.
        Adaptive(AdaptiveRate),
        /// Follows a schedule, regardless of the initial learning rate.
        Line(RateLine),
    }

    /// Settings of the constant rate (none).
    pub struct FixedRate {}

    /// A rule that keeps the policy's change per update within a band.
    pub struct AdaptiveRate {
        /// The rate grows after an update with a KL divergence below this.
        pub low_kl: f32 = 0.005, in above(0.0);
        /// The rate shrinks after an update with a KL divergence above this.
        pub high_kl: f32 = 0.02, where |c| c.high_kl > c.low_kl => "above low_kl";
        /// Lowest rate.
        pub min: f32 = 1e-5, in above(0.0);
        /// Highest rate.
        pub max: f32 = 1e-3, where |c| c.max >= c.min && c.max.is_finite() => "at least min";
    }

    /// Settings of the running statistics.
    pub struct NormalizationConfig {
        /// Normalizes features by their running mean and standard deviation.
        pub features: bool = true;
        /// Trains the value head on normalized targets.
        pub values: bool = true;
    }

    /// Settings of the trajectory mailbox.
    pub struct MailboxConfig {
        /// Number of waiting steps at which the mailbox is full; at least `batch_size`.
        pub capacity_steps: usize = 16384;
        /// Trajectories are dropped if their weights are more than this many versions old.
        pub max_policy_lag: u64 = 4, in 0..=1000;
    }

    /// The rule that turns success rates into task probabilities.
    pub enum CurriculumConfig = Paper {
        /// All training blueprints are equally likely.
        Uniform(UniformConfig),
        /// The paper's rule: the less often a blueprint succeeds, the likelier it is (appendix "Curriculum").
        Paper(PaperConfig),
    }

    /// Settings of the uniform curriculum (none).
    pub struct UniformConfig {}

    /// Settings of the paper's curriculum.
    pub struct PaperConfig {
        /// Temperature of the softmax over failure rates.
        pub temperature: f64 = 0.5, in above(0.0);
    }

    /// When checkpoints are written.
    pub struct CheckpointConfig {
        /// Updates between checkpoints.
        pub every_updates: u64 = 50, in 1..;
        /// Number of newest checkpoints to keep on disk.
        pub keep: usize = 3, in 1..;
    }
}

/// The reference policy of PPO's probability ratio.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Objective {
    /// The policy that acted.
    Standard,
    /// The policy at the start of the update; the policy that acted only weights the sample (Hilton, Cobbe, Schulman,
    /// "Batch size-invariance for policy optimization"). Equal to the standard objective when the policy lag is 0.
    Decoupled,
}

/// A learning rate scheduled by environment steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RateLine {
    /// Learning rates, above 0, by environment steps.
    pub points: Schedule,
}

impl Section for RateLine {
    fn schema() -> Schema {
        schema::of::<Self>()
    }

    fn validate_at(&self, path: &str) -> Result<(), InvalidSetting> {
        self.points.check_in(&key(path, "points"), &above(0.0))
    }
}

impl LearnerConfig {
    /// Returns the estimator of advantages.
    pub fn estimator(&self) -> Box<dyn Estimator> {
        Box::new(Gae { gamma: self.gamma, lambda: self.gae_lambda })
    }

    fn mailbox_holds_an_update(&self, path: &str) -> Result<(), InvalidSetting> {
        let capacity = self.mailbox.capacity_steps;
        let key = format_args!("{path}.mailbox.capacity_steps");
        InvalidSetting::check(key, capacity, capacity >= self.batch_size, "at least batch_size")
    }
}

//! Settings of what the learner makes of rewards.

use proto::settings;

use super::Schedule;

settings! {
    /// What the learner changes in the rewards before it learns from them (extensions; the defaults change nothing).
    pub struct RewardsConfig {
        /// Added to the reward of the step that succeeds, so that being done is worth more than being nearly done.
        pub success_bonus: f32 = 0.0, in 0.0..=1000.0;
        /// Factor of the reward's term for wrong connections. At first they outweigh everything, and an agent learns to
        /// touch nothing.
        pub wrong_weight: Schedule = Schedule::Constant(1.0), in 0.0..=100.0;
        /// Advantages are divided by the number of connections of the goal, so that large goals do not outweigh small ones.
        pub advantages_per_link: bool = false;
        /// The time limit is a deadline: the return ends there, in place of the critic's value of the last scene. A policy
        /// can only tell by `policy.features.remaining_time`.
        pub deadline: bool = false;
    }
}

/// The numbers of [`RewardsConfig`] in one update.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RewardFactors {
    /// See [`RewardsConfig::success_bonus`].
    pub success_bonus: f32,
    /// See [`RewardsConfig::wrong_weight`].
    pub wrong_weight: f32,
    /// See [`RewardsConfig::advantages_per_link`].
    pub advantages_per_link: bool,
    /// See [`RewardsConfig::deadline`].
    pub deadline: bool,
}

impl Default for RewardFactors {
    /// Rewards as the world gives them.
    fn default() -> Self {
        RewardsConfig::default().at(0)
    }
}

impl RewardsConfig {
    /// The numbers after `n_env_steps` environment steps.
    pub fn at(&self, n_env_steps: u64) -> RewardFactors {
        RewardFactors {
            success_bonus: self.success_bonus,
            wrong_weight: self.wrong_weight.at(n_env_steps),
            advantages_per_link: self.advantages_per_link,
            deadline: self.deadline,
        }
    }
}

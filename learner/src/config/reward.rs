//! Settings for changing rewards before learning.

use proto::settings;

use super::Schedule;

settings! {
    /// Changes that the learner makes to rewards before it learns from them (extensions; the defaults change nothing).
    pub struct RewardsConfig {
        /// Bonus for the step that succeeds, so that finishing is worth more than nearly finishing.
        pub success_bonus: f32 = 0.0, in 0.0..=1000.0;
        /// Factor of the reward term for wrong connections. Early on, wrong connections outweigh everything else, and
        /// an agent learns to touch nothing.
        pub wrong_weight: Schedule = Schedule::Constant(1.0), in 0.0..=100.0;
        /// Divides advantages by the number of connections in the goal, so that large goals do not outweigh small ones.
        pub advantages_per_link: bool = false;
        /// Treats the time limit as a deadline: the return ends there, without the critic's value of the last scene.
        pub deadline: bool = false;
    }
}

/// The values of [`RewardsConfig`] for one update.
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
    /// Leaves the world's rewards unchanged.
    fn default() -> Self {
        RewardsConfig::default().at(0)
    }
}

impl RewardsConfig {
    /// Returns the values after `n_env_steps` environment steps.
    pub fn at(&self, n_env_steps: u64) -> RewardFactors {
        RewardFactors {
            success_bonus: self.success_bonus,
            wrong_weight: self.wrong_weight.at(n_env_steps),
            advantages_per_link: self.advantages_per_link,
            deadline: self.deadline,
        }
    }
}

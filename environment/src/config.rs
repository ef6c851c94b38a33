//! Every number of the world, with its unit, range and default.
//!
//! The paper gives none of them; the defaults come from experiments with this physics engine.

mod checks;
mod episode;
mod world;

use proto::InvalidSetting;
use serde::{Deserialize, Serialize};

pub use episode::{ForcePenalty, ResetConfig, RewardConfig, SuccessConfig};
pub use world::{MagnetConfig, PhysicsConfig};

use checks::check;

/// Configuration of a [`World`](crate::World).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EnvironmentConfig {
    /// Number of grippers, 1 or 2. Default 2.
    pub n_grippers: u8,
    /// Linear speed of a gripper when an entry of the action is ±1, m/s, 0.01 to 10. Default 3.
    pub max_speed_mps: f32,
    /// Angular speed of a gripper when an entry of the action is ±1, rad/s, 0.01 to 31. Default 6.28.
    pub max_turn_radps: f32,
    /// Steps for which a gripper is disabled when it goes to another block, 0 to 100. Default 0; the paper's
    /// "transition delay" ablation has 2.
    pub transition_delay_steps: u8,
    /// Steps of an episode before it ends with `TimeLimit`, 1 to 10000. Default 100.
    pub episode_steps: u16,
    /// Bodies and time.
    pub physics: PhysicsConfig,
    /// Attraction, snap and break.
    pub magnets: MagnetConfig,
    /// Initial states.
    pub reset: ResetConfig,
    /// Reward.
    pub reward: RewardConfig,
    /// When the blueprint counts as built.
    pub success: SuccessConfig,
}

impl Default for EnvironmentConfig {
    #[expect(clippy::approx_constant, reason = "a chosen speed limit, not one turn")]
    fn default() -> Self {
        Self {
            n_grippers: 2,
            max_speed_mps: 3.0,
            max_turn_radps: 6.28,
            transition_delay_steps: 0,
            episode_steps: 100,
            physics: PhysicsConfig::default(),
            magnets: MagnetConfig::default(),
            reset: ResetConfig::default(),
            reward: RewardConfig::default(),
            success: SuccessConfig::default(),
        }
    }
}

impl EnvironmentConfig {
    /// Checks every value against its documented range.
    ///
    /// # Errors
    /// Names the first field that is out of range, its value and the range.
    pub fn validate(&self) -> Result<(), InvalidSetting> {
        check("n_grippers", self.n_grippers.into(), 1, 2)?;
        check("max_speed_mps", self.max_speed_mps, 0.01, 10.0)?;
        check("max_turn_radps", self.max_turn_radps, 0.01, 31.0)?;
        check("transition_delay_steps", self.transition_delay_steps.into(), 0, 100)?;
        check("episode_steps", self.episode_steps.into(), 1, 10_000)?;
        self.physics.validate()?;
        self.magnets.validate()?;
        self.reset.validate()?;
        self.reward.validate()?;
        self.success.validate()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_valid() {
        assert_eq!(EnvironmentConfig::default().validate(), Ok(()));
    }

    #[test]
    fn a_value_out_of_range_is_named_with_its_range() {
        let message = |change: fn(&mut EnvironmentConfig)| {
            let mut config = EnvironmentConfig::default();
            change(&mut config);
            config.validate().unwrap_err().to_string()
        };
        assert_eq!(message(|c| c.n_grippers = 3), "environment.n_grippers = 3: expected 1..=2");
        assert_eq!(message(|c| c.max_speed_mps = f32::NAN), "environment.max_speed_mps = NaN: expected 0.01..=10");
        assert_eq!(
            message(|c| c.magnets.snap_gap_m = 0.2),
            "environment.magnets.snap_gap_m = 0.2: expected 0.001..=0.045"
        );
        assert_eq!(message(|c| c.reset.yaw_noise_rad = -1.0), "environment.reset.yaw_noise_rad = -1: expected 0..=3.2");
    }
}

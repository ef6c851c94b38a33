//! Initial states, reward and success.

use serde::{Deserialize, Serialize};

use super::checks::check;
use proto::InvalidSetting;

/// Initial states.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ResetConfig {
    /// Blocks lie in a square of this half width about the origin, m, 0.6 to 2.5. Default 0.8.
    pub arena_half_width_m: f32,
    /// Free space between scattered blocks, m, 0.005 to 0.1. Default 0.05, so that none attract.
    pub clearance_m: f32,
    /// A block may rest on a face if its height is at most this many times the shorter side of the face, 1 to 4.
    /// Default 2.
    pub max_slenderness: f32,
    /// A structure stands within this distance of the origin in x and in y, m, 0 to 1. Default 0.2.
    pub structure_offset_m: f32,
    /// Near-goal starts: a block that was taken off lies with its center at most this much farther from its place, in
    /// x and in y, than it must to be free, m, 0.01 to 1. Default 0.15.
    pub near_goal_m: f32,
    /// Near-goal starts: it is turned by up to this much from its wanted yaw, rad, 0 to 3.2. Default 0.3.
    pub yaw_noise_rad: f32,
}

/// How heavy contacts enter the reward.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ForcePenalty {
    /// As part of the potential (paper): a transient hit is refunded when it is over.
    Differenced,
    /// Anew in every step.
    PerStep,
}

/// Reward (paper, appendix "Rewards"; the weights are not in the paper).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RewardConfig {
    /// Reward of a required connection, 0 to 10. Default 1.
    pub connected_weight: f32,
    /// Cost of a connection that the blueprint does not have, 0 to 10. Default 1.
    pub wrong_weight: f32,
    /// Worth of the dense part per required pair when all is in place, half for magnets and half for blocks, 0 to 10.
    /// Default 1.
    pub dense_weight: f32,
    /// Distance d at which the dense position part is `1 − tanh(1)`, m, 0.01 to 10. Default 0.4 (4 units).
    pub distance_scale_m: f32,
    /// Cost of one heavy contact, 0 to 10. Default 0.1.
    pub heavy_contact_weight: f32,
    /// Greatest cost of all heavy contacts, 0 to 10. Default 1.
    pub heavy_contact_cap: f32,
    /// A contact is heavy above this force, in weights of a unit cube, 0.1 to 1000. Default 10.
    pub heavy_contact_cube_weights: f32,
    /// How heavy contacts enter. Default [`ForcePenalty::Differenced`].
    pub force_penalty: ForcePenalty,
}

/// When the blueprint counts as built (paper, appendix "Success Criterion").
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SuccessConfig {
    /// Greatest distance of a block of a required pair from its place as seen from the other, m, 0.001 to 1.
    /// Default 0.02.
    pub max_distance_m: f32,
    /// Greatest angle between them and the wanted one, degrees, 0.1 to 180. Default 10.
    pub max_angle_deg: f32,
    /// Stable success: greatest speed of a block of the blueprint, m/s, 0.001 to 10. Default 0.1.
    pub stable_speed_mps: f32,
    /// Stable success: steps in a row, 1 to 100. Default 3.
    pub stable_steps: u8,
}

impl Default for ResetConfig {
    fn default() -> Self {
        Self {
            arena_half_width_m: 0.8,
            clearance_m: 0.05,
            max_slenderness: 2.0,
            structure_offset_m: 0.2,
            near_goal_m: 0.15,
            yaw_noise_rad: 0.3,
        }
    }
}

impl Default for RewardConfig {
    fn default() -> Self {
        Self {
            connected_weight: 1.0,
            wrong_weight: 1.0,
            dense_weight: 1.0,
            distance_scale_m: 0.4,
            heavy_contact_weight: 0.1,
            heavy_contact_cap: 1.0,
            heavy_contact_cube_weights: 10.0,
            force_penalty: ForcePenalty::Differenced,
        }
    }
}

impl Default for SuccessConfig {
    fn default() -> Self {
        Self { max_distance_m: 0.02, max_angle_deg: 10.0, stable_speed_mps: 0.1, stable_steps: 3 }
    }
}

impl ResetConfig {
    pub(super) fn validate(&self) -> Result<(), InvalidSetting> {
        check("reset.arena_half_width_m", self.arena_half_width_m, 0.6, 2.5)?;
        check("reset.clearance_m", self.clearance_m, 0.005, 0.1)?;
        check("reset.max_slenderness", self.max_slenderness, 1.0, 4.0)?;
        check("reset.structure_offset_m", self.structure_offset_m, 0.0, 1.0)?;
        check("reset.near_goal_m", self.near_goal_m, 0.01, 1.0)?;
        check("reset.yaw_noise_rad", self.yaw_noise_rad, 0.0, 3.2)
    }
}

impl RewardConfig {
    pub(super) fn validate(&self) -> Result<(), InvalidSetting> {
        check("reward.connected_weight", self.connected_weight, 0.0, 10.0)?;
        check("reward.wrong_weight", self.wrong_weight, 0.0, 10.0)?;
        check("reward.dense_weight", self.dense_weight, 0.0, 10.0)?;
        check("reward.distance_scale_m", self.distance_scale_m, 0.01, 10.0)?;
        check("reward.heavy_contact_weight", self.heavy_contact_weight, 0.0, 10.0)?;
        check("reward.heavy_contact_cap", self.heavy_contact_cap, 0.0, 10.0)?;
        check("reward.heavy_contact_cube_weights", self.heavy_contact_cube_weights, 0.1, 1000.0)
    }
}

impl SuccessConfig {
    pub(super) fn validate(&self) -> Result<(), InvalidSetting> {
        check("success.max_distance_m", self.max_distance_m, 0.001, 1.0)?;
        check("success.max_angle_deg", self.max_angle_deg, 0.1, 180.0)?;
        check("success.stable_speed_mps", self.stable_speed_mps, 0.001, 10.0)?;
        super::checks::check("success.stable_steps", self.stable_steps.into(), 1, 100)
    }
}

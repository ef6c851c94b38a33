//! The PPO objective's settings.

use serde::{Deserialize, Serialize};

use super::{InvalidSetting, Schedule, check, check_at_least, check_positive};

/// The PPO objective.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LossConfig {
    /// Probability ratios beyond 1 ± this are clipped; above 0, at most 1, default 0.2.
    pub clip: f32,
    /// Clip of the value's change in units of the normalized value; above 0; `None` (default) is off, as it hurts.
    pub value_clip: Option<f32>,
    /// Weight of the value loss; at least 0, default 0.5.
    pub value_coefficient: f32,
    /// Weight of the entropy of the block choice, nats; -1..=1, default 0.005. Below 0 it makes the policy decide, so that
    /// its mode does what its samples do.
    pub block_entropy: Schedule,
    /// Weight of the expected entropy of the moves, nats; -1..=1, default 0.0001.
    pub move_entropy: Schedule,
    /// What the ratio is taken against.
    pub objective: Objective,
    /// With the decoupled objective the importance weight of a sample is at most this; at least 1, default 2.
    pub max_behavior_weight: f32,
}

/// What PPO's probability ratio is taken against.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Objective {
    /// The policy that acted.
    Standard,
    /// The policy at the start of the update; the policy that acted only weighs the sample (Hilton, Cobbe, Schulman,
    /// "Batch size-invariance for policy optimization"). Equal to the standard one when the policy lag is 0.
    Decoupled,
}

/// The numbers of the loss in one update.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LossTerms {
    /// Weight of the clipped surrogate and the entropies; 1 without imitation.
    pub policy: f32,
    /// Weight of KL(imitator ‖ policy); 0 without imitation.
    pub imitator_kl: f32,
    /// See [`LossConfig::clip`].
    pub clip: f32,
    /// See [`LossConfig::value_clip`].
    pub value_clip: Option<f32>,
    /// See [`LossConfig::value_coefficient`].
    pub value_coefficient: f32,
    /// See [`LossConfig::block_entropy`].
    pub block_entropy: f32,
    /// See [`LossConfig::move_entropy`].
    pub move_entropy: f32,
}

impl Default for LossConfig {
    fn default() -> Self {
        Self {
            clip: 0.2,
            value_clip: None,
            value_coefficient: 0.5,
            block_entropy: Schedule::Constant(0.005),
            move_entropy: Schedule::Constant(1e-4),
            objective: Objective::Decoupled,
            max_behavior_weight: 2.0,
        }
    }
}

impl LossConfig {
    /// The numbers after `n_env_steps` environment steps.
    pub fn at(&self, n_env_steps: u64) -> LossTerms {
        LossTerms {
            policy: 1.0,
            imitator_kl: 0.0,
            clip: self.clip,
            value_clip: self.value_clip,
            value_coefficient: self.value_coefficient,
            block_entropy: self.block_entropy.at(n_env_steps),
            move_entropy: self.move_entropy.at(n_env_steps),
        }
    }

    pub(super) fn validate(&self) -> Result<(), InvalidSetting> {
        check("loss.clip", self.clip.into(), self.clip > 0.0 && self.clip <= 1.0, "above 0 and at most 1")?;
        if let Some(clip) = self.value_clip {
            check_positive("loss.value_clip", clip)?;
        }
        check_at_least("loss.value_coefficient", self.value_coefficient, 0.0, "at least 0")?;
        check_schedule("loss.block_entropy", &self.block_entropy)?;
        check_schedule("loss.move_entropy", &self.move_entropy)?;
        check_at_least("loss.max_behavior_weight", self.max_behavior_weight, 1.0, "at least 1")
    }
}

fn check_schedule(field: &'static str, schedule: &Schedule) -> Result<(), InvalidSetting> {
    let values = schedule.values();
    let first = values.first().copied().unwrap_or(f32::NAN);
    check(field, first.into(), schedule.is_ordered(), "a number, or points of ascending environment steps")?;
    values.into_iter().try_for_each(|x| check(field, x.into(), (-1.0..=1.0).contains(&x), "-1..=1"))
}

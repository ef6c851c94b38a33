//! What is learned from the expert's labels.

use serde::{Deserialize, Serialize};

use super::{InvalidSetting, Schedule, check, check_at_least, check_positive};

/// Learning from the expert's labels, alone or together with PPO: every gradient step minimizes one weighted sum.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ImitationConfig {
    /// Weight of the imitation loss; 0..=100, default 1. At 0 no labels are drawn.
    pub weight: Schedule,
    /// Weight of PPO's policy loss and entropies; 0..=100, default 0.
    pub ppo_weight: Schedule,
    /// Factor of the value loss; 0..=100, default 0. It may rise before `ppo_weight`, so that the critic knows the policy's
    /// returns when PPO begins.
    pub value_weight: Schedule,
    /// Weight of KL(imitator ‖ policy) on PPO's samples, where the imitator is the policy when this first was above 0;
    /// 0..=100, default 0.
    pub kl_weight: Schedule,
    /// Weight of the loss of moves against that of block choices; at least 0, default 20.
    pub move_weight: f32,
    /// Errors of a move's entries count by their square below this and by their size above; above 0, default 0.1.
    pub move_delta: f32,
    /// Scenes of one gradient step; 1..=65536, default 256.
    pub minibatch_size: usize,
    /// Gradient steps of an update, at least; PPO's own come on top if they are more. 1..=65536, default 32.
    pub steps_per_update: usize,
    /// Where labeled scenes are kept.
    pub replay: ReplayConfig,
}

/// The store of labeled scenes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReplayConfig {
    /// Most scenes; at least 1024, default 60 000. One takes about 1.3 KB, in memory and in a checkpoint.
    pub capacity_steps: usize,
    /// Goals of n blocks are drawn in proportion to n to this power: 0 for all sizes alike; -4..=4, default 1.
    pub size_power: f64,
}

impl Default for ImitationConfig {
    fn default() -> Self {
        Self {
            weight: Schedule::Constant(1.0),
            ppo_weight: Schedule::Constant(0.0),
            value_weight: Schedule::Constant(0.0),
            kl_weight: Schedule::Constant(0.0),
            move_weight: 20.0,
            move_delta: 0.1,
            minibatch_size: 256,
            steps_per_update: 32,
            replay: ReplayConfig::default(),
        }
    }
}

impl Default for ReplayConfig {
    fn default() -> Self {
        Self { capacity_steps: 60_000, size_power: 1.0 }
    }
}

impl ImitationConfig {
    pub(super) fn validate(&self) -> Result<(), InvalidSetting> {
        check_weight("imitation.weight", &self.weight)?;
        check_weight("imitation.ppo_weight", &self.ppo_weight)?;
        check_weight("imitation.value_weight", &self.value_weight)?;
        check_weight("imitation.kl_weight", &self.kl_weight)?;
        check_at_least("imitation.move_weight", self.move_weight, 0.0, "at least 0")?;
        check_positive("imitation.move_delta", self.move_delta)?;
        let (size, steps) = (self.minibatch_size, self.steps_per_update);
        check("imitation.minibatch_size", size as f64, (1..=65536).contains(&size), "1..=65536")?;
        check("imitation.steps_per_update", steps as f64, (1..=65536).contains(&steps), "1..=65536")?;
        let capacity = self.replay.capacity_steps;
        check("imitation.replay.capacity_steps", capacity as f64, capacity >= 1024, "at least 1024")?;
        let power = self.replay.size_power;
        check("imitation.replay.size_power", power, (-4.0..=4.0).contains(&power), "-4..=4")
    }
}

fn check_weight(field: &'static str, schedule: &Schedule) -> Result<(), InvalidSetting> {
    let values = schedule.values();
    let first = values.first().copied().unwrap_or(f32::NAN);
    check(field, first.into(), schedule.is_ordered(), "a number, or points of ascending environment steps")?;
    values.into_iter().try_for_each(|x| check(field, x.into(), (0.0..=100.0).contains(&x), "0..=100"))
}

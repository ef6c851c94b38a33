//! What an estimator of advantages is; [`gae`](crate::gae) is the paper's.

use std::fmt::Debug;

/// One segment of an episode. Slices have one entry per step; rewards and values have the same unit.
#[derive(Clone, Copy, Debug)]
pub struct Steps<'a> {
    /// Rewards.
    pub rewards: &'a [f32],
    /// The critic's values of the scenes before the actions.
    pub values: &'a [f32],
    /// The value after the last step. It alone distinguishes a time limit or a cut from a true end.
    pub bootstrap: f32,
    /// Importance ratios: the probability density of each action under the newest weights, divided by that under the
    /// weights that acted.
    pub ratios: &'a [f32],
}

/// Estimates by how much actions were better than the policy's average.
pub trait Estimator: Debug + Send {
    /// Writes one advantage per step. The critic learns their sums with the values.
    fn advantages(&self, steps: &Steps<'_>, advantages: &mut [f32]);
}

//! What an estimator of advantages is. [`gae`](crate::gae) is the paper's; V-trace (Espeholt et al., 2018) would be:
//!
//! ```
//! use learner::advantages::{Estimator, Steps};
//!
//! #[derive(Debug)]
//! struct VTrace { gamma: f32 }
//!
//! impl Estimator for VTrace {
//!     fn advantages(&self, steps: &Steps<'_>, advantages: &mut [f32]) {
//!         let (mut value, mut advantage) = (steps.bootstrap, 0.0);
//!         for t in (0..steps.rewards.len()).rev() {
//!             let delta = steps.rewards[t] + self.gamma * (value + advantage) - steps.values[t];
//!             advantage = steps.ratios[t].min(1.0) * delta;
//!             (advantages[t], value) = (advantage, steps.values[t]);
//!         }
//!     }
//! }
//! # let (rewards, values) = (&[1.0, 2.0], &[1.0, 2.0]);
//! # let mut found = [0.0; 2];
//! # VTrace { gamma: 0.5 }.advantages(&Steps { rewards, values, bootstrap: 4.0, ratios: &[0.5, 3.0] }, &mut found);
//! # // The last step: 2 + 0.5 · 4 - 2 = 2. The first: 0.5 · (1 + 0.5 · (2 + 2) - 1) = 1.
//! # assert_eq!(found, [1.0, 2.0]);
//! ```

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

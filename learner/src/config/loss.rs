//! Settings of the PPO objective.

use proto::setting::above_to;
use proto::settings;
use serde::{Deserialize, Serialize};

use super::Schedule;

settings! {
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

//! World settings, each with its unit, range, and default.
//!
//! The paper gives none of these numbers. The defaults come from experiments with this physics engine.
#![expect(clippy::approx_constant, reason = "6.28 is a chosen speed limit, not one turn")]

use proto::{InvalidSetting, settings};
use serde::{Deserialize, Serialize};

settings! {
    /// Configuration of a [`World`](crate::World).
    pub struct EnvironmentConfig in "environment" {
        /// Number of grippers.
        pub n_grippers: u8 = 2, in 1..=2;
        /// Linear speed of a gripper at an action entry of ±1, m/s.
        pub max_speed_mps: f32 = 3.0, in 0.01..=10.0;
        /// Angular speed of a gripper at an action entry of ±1, rad/s.
        pub max_turn_radps: f32 = 6.28, in 0.01..=31.0;
        /// Steps for which a gripper is disabled when it switches to another block. The paper's "transition delay"
        /// ablation uses 2.
        pub transition_delay_steps: u8 = 0, in 0..=100;
        /// Maximum episode length in steps, after which the episode ends with `TimeLimit`.
        pub episode_steps: u16 = 100, in 1..=1000;
        /// Rigid bodies and time steps.
        pub physics: PhysicsConfig;
        /// Magnet attraction, snapping, and breaking.
        pub magnets: MagnetConfig;
        /// Initial states.
        pub reset: ResetConfig;
        /// Reward terms.
        pub reward: RewardConfig;
        /// When the blueprint counts as built.
        pub success: SuccessConfig;
        /// Domain randomization per episode.
        pub randomization: RandomizationConfig;
    }

    /// Rigid bodies and time steps.
    pub struct PhysicsConfig {
        /// Physics substeps per control step; 5 of 20 ms halve the cost.
        pub n_substeps: u8 = 10, in 1..=100;
        /// Length of a substep in ms; by default, a control step takes 0.1 s.
        pub substep_ms: f32 = 10.0, in 1.0..=50.0;
        /// Merges substeps into one of up to 20 ms while the solver handles no awake structure of three or more blocks.
        /// Larger structures sag unless substeps are short.
        pub merge_substeps: bool = true;
        /// Gravity in m/s², toward −z.
        pub gravity_mps2: f32 = 9.81, in 0.0..=30.0;
        /// Density of the blocks in kg/m³; by default, a unit cube weighs 0.2 kg.
        pub density_kgpm3: f32 = 200.0, in 10.0..=5000.0;
        /// Coefficient of Coulomb friction between blocks and with the ground.
        pub friction: f32 = 0.6, in 0.0..=2.0;
        /// Linear and angular damping, 1/s.
        pub damping_hz: f32 = 0.5, in 0.0..=10.0;
        /// Distance from the origin at which a block counts as lost and the episode as `Diverged`, m. The default
        /// exceeds the distance that a gripper can carry a block along one axis in an episode (3 m/s for 10 s).
        /// Episodes in which the agent flies off with its blocks must stay in the data, or it never learns not to.
        pub runaway_m: f32 = 40.0, in 1.0..=50.0;
        /// Damping of the motor on each held block when two grippers hold one structure, N·s/m.
        pub motor_damping: f32 = 60.0, in 1.0..=1000.0;
        /// Maximum force of that motor, N.
        pub motor_force_n: f32 = 200.0, in 1.0..=10_000.0;
        /// Angular damping of that motor, N·m·s/rad.
        pub motor_angular_damping: f32 = 6.0, in 0.1..=100.0;
        /// Maximum torque of that motor, N·m.
        pub motor_torque_nm: f32 = 20.0, in 0.1..=1000.0;
    }

    /// The hybrid magnet model: a short-range attraction, then one fixed joint per block pair.
    ///
    /// Forces alone never hold a structure together, and joints alone catch only blocks that are already in place.
    pub struct MagnetConfig {
        /// Distance between two opposite magnets below which they attract, m.
        pub attraction_range_m: f32 = 0.04, in 0.0..=0.05;
        /// Attraction of a magnet pair at distance 0, N. It falls linearly to 0 at `attraction_range_m`.
        pub attraction_peak_n: f32 = 8.0, in 0.0..=100.0;
        /// Distance between two opposite magnets below which their blocks snap together, m. At half a cell, 0.05, the
        /// partner would be ambiguous; at 0.015, a policy with noise σ = 0.2 succeeds half as often.
        pub snap_gap_m: f32 = 0.03, in 0.001..=0.045;
        /// Maximum angle for a snap between the blocks' relative orientation and the nearest of the 24 cube rotations,
        /// degrees.
        pub snap_angle_deg: f32 = 15.0, in 1.0..=40.0;
        /// Time for which a new joint cannot break and, after a snap, is soft, ms.
        pub snap_ms: f32 = 200.0, in 0.0..=2000.0;
        /// Stiffness of the joint during the snap, Hz.
        pub snap_frequency_hz: f32 = 20.0, in 1.0..=1000.0;
        /// Stiffness of the joint afterwards, Hz.
        pub hold_frequency_hz: f32 = 60.0, in 1.0..=1000.0;
        /// Force that breaks a connection, N per magnet pair. The breaking torque is this times one unit (0.1 m).
        pub break_force_n: f32 = 30.0, in 1.0..=10_000.0;
        /// Maximum number of magnet pairs that count toward a connection's strength.
        pub break_max_pairs: u8 = 3, in 1..=6;
        /// Weight of the past in the running mean of a joint's load, per substep.
        pub load_smoothing: f32 = 0.5, in 0.0..=0.99;
        /// Time after a break during which the two blocks neither attract nor snap, ms.
        pub cooldown_ms: f32 = 200.0, in 0.0..=2000.0;
    }

    /// Initial states.
    pub struct ResetConfig {
        /// Half width of the square around the origin in which blocks are scattered, m.
        pub arena_half_width_m: f32 = 0.8, in 0.6..=2.5;
        /// Minimum gap between scattered blocks, m; by default, none attract.
        pub clearance_m: f32 = 0.05, in 0.005..=0.1;
        /// Maximum ratio of a scattered block's height to the shorter side of the face that it rests on.
        pub max_slenderness: f32 = 2.0, in 1.0..=4.0;
        /// Maximum offset of a structure from the origin in x and in y, m.
        pub structure_offset_m: f32 = 0.2, in 0.0..=1.0;
        /// Near-goal starts: maximum distance of a removed block's center from its target in x and in y, m. It grows by
        /// 2 % with every attempt that finds no free ground.
        pub near_goal_m: f32 = 0.15, in 0.01..=1.0;
        /// Near-goal starts: maximum rotation of a removed block from its target yaw, rad.
        pub yaw_noise_rad: f32 = 0.3, in 0.0..=3.2;
    }

    /// Domain randomization (Tobin et al., 2017). Each range `[low, high]` draws a uniform value per episode; `None`
    /// keeps the setting. Scattered, prebuilt, and near-goal starts draw; a start "as it is" keeps the previous values.
    /// Neither the policy nor the expert sees the drawn values.
    pub struct RandomizationConfig, check order {
        /// Replaces `magnets.snap_gap_m`, m.
        pub snap_gap_m: Option<[f32; 2]> = None, in 0.001..=0.045;
        /// Replaces `magnets.snap_angle_deg`, degrees.
        pub snap_angle_deg: Option<[f32; 2]> = None, in 1.0..=40.0;
        /// Factor on `magnets.break_force_n`.
        pub break_force: Option<[f32; 2]> = None, in 0.1..=10.0;
        /// Factor on `physics.friction`.
        pub friction: Option<[f32; 2]> = None, in 0.1..=10.0;
        /// Factor on `physics.density_kgpm3`.
        pub density: Option<[f32; 2]> = None, in 0.1..=10.0;
        /// Replaces `transition_delay_steps`.
        pub transition_delay_steps: Option<[u8; 2]> = None, in 0..=100;
    }

    /// Reward (paper, appendix "Rewards"; the weights are not in the paper).
    pub struct RewardConfig {
        /// Reward per required connection.
        pub connected_weight: f32 = 1.0, in 0.0..=10.0;
        /// Cost per connection that the blueprint does not have.
        pub wrong_weight: f32 = 1.0, in 0.0..=10.0;
        /// Dense reward of a required pair that is exactly in place, half for its magnets and half for its blocks.
        pub dense_weight: f32 = 1.0, in 0.0..=10.0;
        /// Distance at which the dense position term is `1 − tanh(1)`, m; 4 units by default.
        pub distance_scale_m: f32 = 0.4, in 0.01..=10.0;
        /// Cost per heavy contact.
        pub heavy_contact_weight: f32 = 0.1, in 0.0..=10.0;
        /// Maximum total cost of heavy contacts.
        pub heavy_contact_cap: f32 = 1.0, in 0.0..=10.0;
        /// Force above which a contact is heavy, in weights of a unit cube.
        pub heavy_contact_cube_weights: f32 = 10.0, in 0.1..=1000.0;
        /// How heavy contacts enter the reward.
        pub force_penalty: ForcePenalty = ForcePenalty::Differenced;
    }

    /// When the blueprint counts as built (paper, appendix "Success Criterion").
    pub struct SuccessConfig {
        /// Maximum distance of a block in a required pair from its target relative to the other block, m.
        pub max_distance_m: f32 = 0.02, in 0.001..=1.0;
        /// Maximum angle between the pair's relative orientation and the wanted one, degrees.
        pub max_angle_deg: f32 = 10.0, in 0.1..=180.0;
        /// Stable success: maximum speed of the blueprint's blocks, m/s.
        pub stable_speed_mps: f32 = 0.1, in 0.001..=10.0;
        /// Stable success: required number of consecutive steps.
        pub stable_steps: u8 = 3, in 1..=100;
    }
}

/// How heavy contacts enter the reward.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ForcePenalty {
    /// As part of the potential (paper): the cost of a transient contact is refunded when it ends.
    Differenced,
    /// As a cost in every step.
    PerStep,
}

impl EnvironmentConfig {
    /// Returns the same configuration without randomization.
    pub fn nominal(&self) -> Self {
        Self { randomization: RandomizationConfig::default(), ..self.clone() }
    }
}

impl RandomizationConfig {
    fn order(&self, path: &str) -> Result<(), InvalidSetting> {
        let Self { snap_gap_m, snap_angle_deg, break_force, friction, density, transition_delay_steps } = *self;
        let delay = transition_delay_steps.map(|range| range.map(f32::from));
        for (field, range) in [
            ("snap_gap_m", snap_gap_m),
            ("snap_angle_deg", snap_angle_deg),
            ("break_force", break_force),
            ("friction", friction),
            ("density", density),
            ("transition_delay_steps", delay),
        ] {
            let Some([low, high]) = range else { continue };
            let expected = "the lower end first";
            InvalidSetting::check(
                format_args!("{path}.{field}"),
                format_args!("[{low}, {high}]"),
                low <= high,
                expected,
            )?;
        }
        Ok(())
    }
}

impl PhysicsConfig {
    /// Returns the length of a substep in seconds.
    pub fn substep_s(&self) -> f32 {
        self.substep_ms / 1000.0
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
        assert_eq!(
            message(|c| c.randomization.snap_gap_m = Some([0.03, 0.01])),
            "environment.randomization.snap_gap_m = [0.03, 0.01]: expected the lower end first"
        );
        assert_eq!(message(|c| c.reset.yaw_noise_rad = -1.0), "environment.reset.yaw_noise_rad = -1: expected 0..=3.2");
    }
}

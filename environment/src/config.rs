//! World settings, each with its unit, range, and default.
//!
//! The paper gives none of these numbers. The defaults come from experiments with this physics engine.
#![expect(clippy::approx_constant, reason = "6.28 is a chosen speed limit, not one turn")]

use proto::{Valid, settings};

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
        /// Rigid bodies.
        pub physics: PhysicsConfig;
        /// Magnet attraction, snapping, and breaking.
        pub magnets: MagnetConfig;
        /// Reward terms.
        pub reward: RewardConfig;
        /// When the blueprint counts as built.
        pub success: SuccessConfig;
        /// Domain randomization per episode.
        pub randomization: RandomizationConfig;
    }

    /// Rigid bodies.
    pub struct PhysicsConfig {
        /// Gravity in m/s², toward −z.
        pub gravity_mps2: f32 = 9.81, in 0.0..=30.0;
        /// Density of the blocks in kg/m³; by default, a unit cube weighs 0.2 kg.
        pub density_kgpm3: f32 = 200.0, in 10.0..=5000.0;
        /// Coefficient of Coulomb friction between blocks and with the ground.
        pub friction: f32 = 0.6, in 0.0..=2.0;
    }

    /// The hybrid magnet model: a short-range attraction, then one fixed joint per block pair.
    ///
    /// Forces alone never hold a structure together, and joints alone catch only blocks that are already in place.
    pub struct MagnetConfig {
        /// Distance between two opposite magnets below which their blocks snap together, m. At half a cell, 0.05, the
        /// partner would be ambiguous; at 0.015, a policy with noise σ = 0.2 succeeds half as often.
        pub snap_gap_m: f32 = 0.03, in 0.001..=0.045;
        /// Maximum angle for a snap between the blocks' relative orientation and the nearest of the 24 cube rotations,
        /// degrees.
        pub snap_angle_deg: f32 = 15.0, in 1.0..=40.0;
        /// Force that breaks a connection, N per magnet pair. The breaking torque is this times one unit (0.1 m).
        pub break_force_n: f32 = 30.0, in 1.0..=10_000.0;
    }

    /// Domain randomization (Tobin et al., 2017). Each range `[low, high]` draws a uniform value per episode; `None`
    /// keeps the setting. Scattered, prebuilt, and near-goal starts draw; a start "as it is" keeps the previous values.
    /// Neither the policy nor the expert sees the drawn values.
    pub struct RandomizationConfig {
        /// Replaces `magnets.snap_gap_m`, m.
        pub snap_gap_m: Option<[f32; 2]> = None, in 0.001..=0.045,
            where |c| ascends(c.snap_gap_m) => "the lower end first";
        /// Replaces `magnets.snap_angle_deg`, degrees.
        pub snap_angle_deg: Option<[f32; 2]> = None, in 1.0..=40.0,
            where |c| ascends(c.snap_angle_deg) => "the lower end first";
        /// Factor on `magnets.break_force_n`.
        pub break_force: Option<[f32; 2]> = None, in 0.1..=10.0,
            where |c| ascends(c.break_force) => "the lower end first";
        /// Factor on `physics.friction`.
        pub friction: Option<[f32; 2]> = None, in 0.1..=10.0,
            where |c| ascends(c.friction) => "the lower end first";
        /// Factor on `physics.density_kgpm3`.
        pub density: Option<[f32; 2]> = None, in 0.1..=10.0,
            where |c| ascends(c.density) => "the lower end first";
        /// Replaces `transition_delay_steps`.
        pub transition_delay_steps: Option<[u8; 2]> = None, in 0..=100,
            where |c| ascends(c.transition_delay_steps) => "the lower end first";
    }

    /// Reward (paper, appendix "Rewards"; the weights are not in the paper). The unit of the weights is the reward of a
    /// required connection.
    pub struct RewardConfig {
        /// Cost per connection that the blueprint does not have.
        pub wrong_weight: f32 = 1.0, in 0.0..=10.0;
        /// Dense reward of a required pair that is exactly in place, half for its magnets and half for its blocks.
        pub dense_weight: f32 = 1.0, in 0.0..=10.0;
        /// Cost per heavy contact, one with more than ten times the weight of a unit cube.
        pub heavy_contact_weight: f32 = 0.1, in 0.0..=10.0;
    }

    /// When the blueprint counts as built (paper, appendix "Success Criterion").
    pub struct SuccessConfig {
        /// Maximum distance of a block in a required pair from its target relative to the other block, m.
        pub max_distance_m: f32 = 0.02, in 0.001..=1.0;
        /// Maximum angle between the pair's relative orientation and the wanted one, degrees.
        pub max_angle_deg: f32 = 10.0, in 0.1..=180.0;
    }
}

impl EnvironmentConfig {
    /// Returns the same configuration without randomization.
    pub fn nominal(config: &Valid<Self>) -> Valid<Self> {
        config.with(|config| config.randomization = RandomizationConfig::default()).expect("it has no ranges to check")
    }
}

fn ascends<T: PartialOrd>(range: Option<[T; 2]>) -> bool {
    range.is_none_or(|range| range.is_sorted())
}

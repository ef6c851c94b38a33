//! Every number of the world, with its unit, range and default.
//!
//! The paper gives none of them; the defaults come from experiments with this physics engine.
#![expect(clippy::approx_constant, reason = "6.28 is a chosen speed limit, not one turn")]

use proto::{InvalidSetting, settings};
use serde::{Deserialize, Serialize};

settings! {
    /// Configuration of a [`World`](crate::World).
    pub struct EnvironmentConfig in "environment" {
        /// Number of grippers.
        pub n_grippers: u8 = 2, in 1..=2;
        /// Linear speed of a gripper when an entry of the action is ±1, m/s.
        pub max_speed_mps: f32 = 3.0, in 0.01..=10.0;
        /// Angular speed of a gripper when an entry of the action is ±1, rad/s.
        pub max_turn_radps: f32 = 6.28, in 0.01..=31.0;
        /// Steps for which a gripper is disabled when it goes to another block; the paper's "transition delay"
        /// ablation has 2.
        pub transition_delay_steps: u8 = 0, in 0..=100;
        /// Steps of an episode before it ends with `TimeLimit`.
        pub episode_steps: u16 = 100, in 1..=10_000;
        /// Bodies and time.
        pub physics: PhysicsConfig;
        /// Attraction, snap and break.
        pub magnets: MagnetConfig;
        /// Initial states.
        pub reset: ResetConfig;
        /// Reward.
        pub reward: RewardConfig;
        /// When the blueprint counts as built.
        pub success: SuccessConfig;
        /// What differs from episode to episode.
        pub randomization: RandomizationConfig;
    }

    /// Bodies and time.
    pub struct PhysicsConfig {
        /// Physics substeps in a control step; 5 of 20 ms halve the cost.
        pub n_substeps: u8 = 10, in 1..=100;
        /// Length of a substep in ms; by default a control step takes 0.1 s.
        pub substep_ms: f32 = 10.0, in 1.0..=50.0;
        /// Computes as many substeps as fit into 20 ms as one while no three blocks hang together that are awake and that
        /// the solver works on. Larger structures need short substeps, or they sag.
        pub merge_substeps: bool = true;
        /// Gravity in m/s², toward −z.
        pub gravity_mps2: f32 = 9.81, in 0.0..=30.0;
        /// Density of the blocks in kg/m³; by default a unit cube weighs 0.2 kg.
        pub density_kgpm3: f32 = 200.0, in 10.0..=5000.0;
        /// Coulomb friction between blocks and with the ground.
        pub friction: f32 = 0.6, in 0.0..=2.0;
        /// Linear and angular damping, 1/s.
        pub damping_hz: f32 = 0.5, in 0.0..=10.0;
        /// Distance from the origin at which a block counts as lost and the episode as `Diverged`, m. The
        /// default is farther than a gripper can carry a block in an episode (3 m/s for 10 s): what the agent itself
        /// did, such as flying off with its blocks, must stay in the data, or it never learns to leave it.
        pub runaway_m: f32 = 40.0, in 1.0..=50.0;
        /// Damping of the motor on each held block when two grippers hold one structure, N·s/m.
        pub motor_damping: f32 = 60.0, in 1.0..=1000.0;
        /// Greatest force of that motor in N.
        pub motor_force_n: f32 = 200.0, in 1.0..=10_000.0;
        /// Its angular damping, N·m·s/rad.
        pub motor_angular_damping: f32 = 6.0, in 0.1..=100.0;
        /// Its greatest torque in N·m.
        pub motor_torque_nm: f32 = 20.0, in 0.1..=1000.0;
    }

    /// The hybrid magnet model: a short-range attraction, then one fixed joint per block pair.
    ///
    /// Forces alone never hold a structure together, and joints alone catch only what is already in place.
    pub struct MagnetConfig {
        /// Distance between two opposite magnets below which they attract, m.
        pub attraction_range_m: f32 = 0.04, in 0.0..=0.05;
        /// Attraction of one magnet pair at distance 0, falling linearly to 0 at the range, N.
        pub attraction_peak_n: f32 = 8.0, in 0.0..=100.0;
        /// Distance between two opposite magnets below which their blocks snap together, m. Half a cell, 0.05, would
        /// make the partner ambiguous; at 0.015 a policy with noise σ = 0.2 succeeds half as often.
        pub snap_gap_m: f32 = 0.03, in 0.001..=0.045;
        /// Greatest angle between the blocks' relative orientation and the nearest of the 24 cube rotations for a snap,
        /// degrees.
        pub snap_angle_deg: f32 = 15.0, in 1.0..=40.0;
        /// Time in which the joint is soft and cannot break, ms.
        pub snap_ms: f32 = 200.0, in 0.0..=2000.0;
        /// Stiffness of the joint during the snap, Hz.
        pub snap_frequency_hz: f32 = 20.0, in 1.0..=1000.0;
        /// Stiffness of the joint afterwards, Hz.
        pub hold_frequency_hz: f32 = 60.0, in 1.0..=1000.0;
        /// Force that breaks a connection, N per magnet pair. The torque that does is this times one unit (0.1 m).
        pub break_force_n: f32 = 30.0, in 1.0..=10_000.0;
        /// Magnet pairs beyond this many add no strength.
        pub break_max_pairs: u8 = 3, in 1..=6;
        /// Weight of the past in the running mean of a joint's load per substep.
        pub load_smoothing: f32 = 0.5, in 0.0..=0.99;
        /// Time after a break in which the two blocks neither attract nor snap, ms.
        pub cooldown_ms: f32 = 200.0, in 0.0..=2000.0;
    }

    /// Initial states.
    pub struct ResetConfig {
        /// Blocks lie in a square of this half width about the origin, m.
        pub arena_half_width_m: f32 = 0.8, in 0.6..=2.5;
        /// Free space between scattered blocks, m; by default none attract.
        pub clearance_m: f32 = 0.05, in 0.005..=0.1;
        /// A block may rest on a face if its height is at most this many times the shorter side of the face.
        pub max_slenderness: f32 = 2.0, in 1.0..=4.0;
        /// A structure stands within this distance of the origin in x and in y, m.
        pub structure_offset_m: f32 = 0.2, in 0.0..=1.0;
        /// Near-goal starts: a block that was taken off lies with its center at most this much farther from its place,
        /// in x and in y, than it must to be free, m.
        pub near_goal_m: f32 = 0.15, in 0.01..=1.0;
        /// Near-goal starts: it is turned by up to this much from its wanted yaw, rad.
        pub yaw_noise_rad: f32 = 0.3, in 0.0..=3.2;
    }

    /// Domain randomization (Tobin et al., 2017): each range `[low, high]` gives every episode a value of its own, drawn
    /// evenly; a scattered, prebuilt or near-goal start draws, a start "as it is" keeps what there was. `None` draws nothing.
    /// Neither the policy nor the expert is told.
    pub struct RandomizationConfig, check order {
        /// In place of `magnets.snap_gap_m`, m.
        pub snap_gap_m: Option<[f32; 2]> = None, in 0.001..=0.045;
        /// In place of `magnets.snap_angle_deg`, degrees.
        pub snap_angle_deg: Option<[f32; 2]> = None, in 1.0..=40.0;
        /// Factor of `magnets.break_force_n`.
        pub break_force: Option<[f32; 2]> = None, in 0.1..=10.0;
        /// Factor of `physics.friction`.
        pub friction: Option<[f32; 2]> = None, in 0.1..=10.0;
        /// Factor of `physics.density_kgpm3`.
        pub density: Option<[f32; 2]> = None, in 0.1..=10.0;
        /// In place of `transition_delay_steps`.
        pub transition_delay_steps: Option<[u8; 2]> = None, in 0..=100;
    }

    /// Reward (paper, appendix "Rewards"; the weights are not in the paper).
    pub struct RewardConfig {
        /// Reward of a required connection.
        pub connected_weight: f32 = 1.0, in 0.0..=10.0;
        /// Cost of a connection that the blueprint does not have.
        pub wrong_weight: f32 = 1.0, in 0.0..=10.0;
        /// Worth of the dense part per required pair when all is in place, half for magnets and half for blocks.
        pub dense_weight: f32 = 1.0, in 0.0..=10.0;
        /// Distance d at which the dense position part is `1 − tanh(1)`, m; by default 4 units.
        pub distance_scale_m: f32 = 0.4, in 0.01..=10.0;
        /// Cost of one heavy contact.
        pub heavy_contact_weight: f32 = 0.1, in 0.0..=10.0;
        /// Greatest cost of all heavy contacts.
        pub heavy_contact_cap: f32 = 1.0, in 0.0..=10.0;
        /// A contact is heavy above this force, in weights of a unit cube.
        pub heavy_contact_cube_weights: f32 = 10.0, in 0.1..=1000.0;
        /// How heavy contacts enter.
        pub force_penalty: ForcePenalty = ForcePenalty::Differenced;
    }

    /// When the blueprint counts as built (paper, appendix "Success Criterion").
    pub struct SuccessConfig {
        /// Greatest distance of a block of a required pair from its place as seen from the other, m.
        pub max_distance_m: f32 = 0.02, in 0.001..=1.0;
        /// Greatest angle between them and the wanted one, degrees.
        pub max_angle_deg: f32 = 10.0, in 0.1..=180.0;
        /// Stable success: greatest speed of a block of the blueprint, m/s.
        pub stable_speed_mps: f32 = 0.1, in 0.001..=10.0;
        /// Stable success: steps in a row.
        pub stable_steps: u8 = 3, in 1..=100;
    }
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

impl EnvironmentConfig {
    /// The same without randomization: every episode has the settings themselves.
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
    /// Length of a substep in seconds.
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

//! Bodies, time and magnets.

use serde::{Deserialize, Serialize};

use super::checks::check;
use proto::InvalidSetting;

/// Bodies and time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PhysicsConfig {
    /// Physics substeps in a control step, 1 to 100. Default 10; 5 of 20 ms halve the cost.
    pub n_substeps: u8,
    /// Length of a substep in ms, 1 to 50. Default 10, so that a control step takes 0.1 s.
    pub substep_ms: f32,
    /// Gravity in m/s², 0 to 30, toward −z. Default 9.81.
    pub gravity_mps2: f32,
    /// Density of the blocks in kg/m³, 10 to 5000. Default 200: a unit cube weighs 0.2 kg.
    pub density_kgpm3: f32,
    /// Coulomb friction between blocks and with the ground, 0 to 2. Default 0.6.
    pub friction: f32,
    /// Linear and angular damping, 1/s, 0 to 10. Default 0.5.
    pub damping_hz: f32,
    /// Distance from the origin at which a block counts as lost and the episode as `Diverged`, m, 1 to 50. Default 40, which
    /// is farther than a gripper can carry a block in an episode (3 m/s for 10 s): what the agent itself did, such as
    /// flying off with its blocks, must stay in the data, or it never learns to leave it.
    pub runaway_m: f32,
    /// Damping of the motor on each held block when two grippers hold one structure, N·s/m, 1 to 1000. Default 60.
    pub motor_damping: f32,
    /// Greatest force of that motor in N, 1 to 10000. Default 200.
    pub motor_force_n: f32,
    /// Its angular damping, N·m·s/rad, 0.1 to 100. Default 6.
    pub motor_angular_damping: f32,
    /// Its greatest torque in N·m, 0.1 to 1000. Default 20.
    pub motor_torque_nm: f32,
}

/// The hybrid magnet model: a short-range attraction, then one fixed joint per block pair.
///
/// Forces alone never hold a structure together, and joints alone catch only what is already in place.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MagnetConfig {
    /// Distance between two opposite magnets below which they attract, m, 0 to 0.05. Default 0.04.
    pub attraction_range_m: f32,
    /// Attraction of one magnet pair at distance 0, falling linearly to 0 at the range, N, 0 to 100. Default 8.
    pub attraction_peak_n: f32,
    /// Distance between two opposite magnets below which their blocks snap together, m, 0.001 to 0.045 (half a cell,
    /// 0.05, would make the partner ambiguous). Default 0.03: at 0.015 a policy with noise σ = 0.2 succeeds half as often.
    pub snap_gap_m: f32,
    /// Greatest angle between the blocks' relative orientation and the nearest of the 24 cube rotations for a snap,
    /// degrees, 1 to 40. Default 15.
    pub snap_angle_deg: f32,
    /// Time in which the joint is soft and cannot break, ms, 0 to 2000. Default 200.
    pub snap_ms: f32,
    /// Stiffness of the joint during the snap, Hz, 1 to 1000. Default 20.
    pub snap_frequency_hz: f32,
    /// Stiffness of the joint afterwards, Hz, 1 to 1000. Default 60.
    pub hold_frequency_hz: f32,
    /// Force that breaks a connection, N per magnet pair, 1 to 10000. Default 30. The torque that does is this times
    /// one unit (0.1 m).
    pub break_force_n: f32,
    /// Magnet pairs beyond this many add no strength, 1 to 6. Default 3.
    pub break_max_pairs: u8,
    /// Weight of the past in the running mean of a joint's load per substep, 0 to 0.99. Default 0.5.
    pub load_smoothing: f32,
    /// Time after a break in which the two blocks neither attract nor snap, ms, 0 to 2000. Default 200.
    pub cooldown_ms: f32,
}

impl Default for PhysicsConfig {
    fn default() -> Self {
        Self {
            n_substeps: 10,
            substep_ms: 10.0,
            gravity_mps2: 9.81,
            density_kgpm3: 200.0,
            friction: 0.6,
            damping_hz: 0.5,
            runaway_m: 40.0,
            motor_damping: 60.0,
            motor_force_n: 200.0,
            motor_angular_damping: 6.0,
            motor_torque_nm: 20.0,
        }
    }
}

impl Default for MagnetConfig {
    fn default() -> Self {
        Self {
            attraction_range_m: 0.04,
            attraction_peak_n: 8.0,
            snap_gap_m: 0.03,
            snap_angle_deg: 15.0,
            snap_ms: 200.0,
            snap_frequency_hz: 20.0,
            hold_frequency_hz: 60.0,
            break_force_n: 30.0,
            break_max_pairs: 3,
            load_smoothing: 0.5,
            cooldown_ms: 200.0,
        }
    }
}

impl PhysicsConfig {
    /// Length of a substep in seconds.
    pub fn substep_s(&self) -> f32 {
        self.substep_ms / 1000.0
    }

    pub(super) fn validate(&self) -> Result<(), InvalidSetting> {
        check("physics.n_substeps", self.n_substeps.into(), 1, 100)?;
        check("physics.substep_ms", self.substep_ms, 1.0, 50.0)?;
        check("physics.gravity_mps2", self.gravity_mps2, 0.0, 30.0)?;
        check("physics.density_kgpm3", self.density_kgpm3, 10.0, 5000.0)?;
        check("physics.friction", self.friction, 0.0, 2.0)?;
        check("physics.damping_hz", self.damping_hz, 0.0, 10.0)?;
        check("physics.runaway_m", self.runaway_m, 1.0, 50.0)?;
        check("physics.motor_damping", self.motor_damping, 1.0, 1000.0)?;
        check("physics.motor_force_n", self.motor_force_n, 1.0, 10_000.0)?;
        check("physics.motor_angular_damping", self.motor_angular_damping, 0.1, 100.0)?;
        check("physics.motor_torque_nm", self.motor_torque_nm, 0.1, 1000.0)
    }
}

impl MagnetConfig {
    pub(super) fn validate(&self) -> Result<(), InvalidSetting> {
        check("magnets.attraction_range_m", self.attraction_range_m, 0.0, 0.05)?;
        check("magnets.attraction_peak_n", self.attraction_peak_n, 0.0, 100.0)?;
        check("magnets.snap_gap_m", self.snap_gap_m, 0.001, 0.045)?;
        check("magnets.snap_angle_deg", self.snap_angle_deg, 1.0, 40.0)?;
        check("magnets.snap_ms", self.snap_ms, 0.0, 2000.0)?;
        check("magnets.snap_frequency_hz", self.snap_frequency_hz, 1.0, 1000.0)?;
        check("magnets.hold_frequency_hz", self.hold_frequency_hz, 1.0, 1000.0)?;
        check("magnets.break_force_n", self.break_force_n, 1.0, 10_000.0)?;
        check("magnets.break_max_pairs", self.break_max_pairs.into(), 1, 6)?;
        check("magnets.load_smoothing", self.load_smoothing, 0.0, 0.99)?;
        check("magnets.cooldown_ms", self.cooldown_ms, 0.0, 2000.0)
    }
}

//! When a blueprint counts as built (paper, appendix "Success Criterion").

use blueprints::Blueprint;
use proto::Scene;

use crate::config::SuccessConfig;
use crate::reward::{block_misfit, linked_poses};

/// Stable success: maximum speed of the blueprint's blocks, m/s.
const STABLE_SPEED_MPS: f32 = 0.1;
/// Stable success: required number of consecutive steps.
const STABLE_STEPS: u16 = 3;

/// Returns whether all required connections exist, no others exist, and every required pair is within tolerance.
pub fn is_success(scene: &Scene, blueprint: &Blueprint, config: &SuccessConfig) -> bool {
    let links = blueprint.links();
    // A scene has at most one connection per block pair, so equal counts and no wrong connection make the sets equal.
    let connections_match =
        scene.joints.len() == links.len() && scene.joints.iter().all(|joint| joint.is_right(blueprint));
    let max_angle = config.max_angle_deg.to_radians();
    connections_match
        && links.iter().all(|link| {
            let [a, b] = linked_poses(scene, link);
            let misfit = block_misfit(&a, &b, link);
            misfit.distance <= config.max_distance_m && misfit.angle <= max_angle
        })
}

/// Tracks whether a success lasts: the conditions hold for three consecutive steps while the structure hardly moves.
///
/// Recorded along with the paper's success, so that structures in flight do not count unnoticed.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StableSuccess {
    n_steps: u16,
}

impl StableSuccess {
    /// Observes the scene after a step. Returns true once the success is stable.
    pub fn observe(&mut self, scene: &Scene, blueprint: &Blueprint, config: &SuccessConfig) -> bool {
        let slow = blueprint.placements().iter().all(|p| scene.speeds_mps[p.block.get()] <= STABLE_SPEED_MPS);
        let holds = slow && is_success(scene, blueprint, config);
        self.n_steps = if holds { self.n_steps.saturating_add(1) } else { 0 };
        self.n_steps >= STABLE_STEPS
    }
}

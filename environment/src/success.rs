//! When a blueprint counts as built (paper, appendix "Success Criterion").

use blueprints::Blueprint;
use proto::Scene;

use crate::config::SuccessConfig;
use crate::reward::Fit;

/// Whether all required connections exist, no other exists, and every required pair stands within tolerance.
pub fn is_success(scene: &Scene, blueprint: &Blueprint, config: &SuccessConfig) -> bool {
    let links = blueprint.links();
    // A scene has at most one connection per block pair, so equal numbers and no stranger make the sets equal.
    let connections_match = scene.joints.len() == links.len()
        && scene
            .joints
            .iter()
            .all(|joint| blueprint.link(joint.a, joint.b).is_some_and(|link| link.relative == joint.relative));
    let max_angle = config.max_angle_deg.to_radians();
    connections_match
        && links.iter().all(|link| {
            let misfit = Fit::new(scene, link).blocks;
            misfit.distance <= config.max_distance_m && misfit.angle <= max_angle
        })
}

/// Whether a success lasts: the conditions hold for some steps in a row while the structure hardly moves.
///
/// Recorded beside the paper's success, so that nothing in flight is counted unnoticed.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StableSuccess {
    n_steps: u16,
}

impl StableSuccess {
    /// Takes the scene after a step; true once the success is stable.
    pub fn observe(&mut self, scene: &Scene, blueprint: &Blueprint, config: &SuccessConfig) -> bool {
        let slow = blueprint.placements().iter().all(|p| scene.speeds_mps[p.block.get()] <= config.stable_speed_mps);
        let holds = slow && is_success(scene, blueprint, config);
        self.n_steps = if holds { self.n_steps.saturating_add(1) } else { 0 };
        self.n_steps >= u16::from(config.stable_steps)
    }
}

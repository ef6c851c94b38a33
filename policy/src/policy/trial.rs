//! The scene on which new weights are tested before they act.

use blueprints::{Blueprint, N_BLOCKS};
use proto::{Gripper, Pose, Scene};

/// Blocks on a rising spiral, two of the goal's blocks held. Every feature is nonzero somewhere, except those of
/// connections.
pub(super) fn scene(goal: &Blueprint) -> Scene {
    // A rotation by 2 atan(3/4) about an axis between x and z.
    let orientation = [0.36, 0.0, 0.48, 0.8];
    let mut held = goal.placements().iter().map(|placement| placement.block);
    let mut gripper = || {
        Some(Gripper {
            held: held.next(),
            orientation,
            linear_velocity: [0.5, -0.25, 1.0],
            angular_velocity: [-1.0, 0.5, 2.0],
        })
    };
    let pose = |i: usize| {
        let angle = i as f32;
        let radius = 0.3 + 0.05 * i as f32;
        Pose { position: [radius * angle.cos(), radius * angle.sin(), 0.05 + 0.1 * i as f32], orientation }
    };
    let grippers = [gripper(), gripper()];
    Scene { speeds_mps: [0.1; N_BLOCKS], grippers, ..Scene::at_rest(std::array::from_fn(pose)) }
}

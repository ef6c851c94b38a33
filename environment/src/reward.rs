//! Reward as a difference of potentials, each a pure function of scene and blueprint (paper, appendix "Rewards").

use blueprints::{Blueprint, Inventory, Link};
use nalgebra::{Isometry3, Vector3};
use proto::{RewardTerms, Scene};

use crate::config::RewardConfig;
use crate::convert::from_pose;
use crate::magnets::magnet_position_m;

/// Distance at which the dense position term is `1 − tanh(1)`, m; 4 units.
const DISTANCE_SCALE_M: f32 = 0.4;
/// Maximum total cost of heavy contacts.
const HEAVY_CONTACT_CAP: f32 = 1.0;

/// Returns how good a scene is, by term.
///
/// Each required block pair adds 1 if it is connected as in the blueprint, and a dense part of at most `dense_weight`:
/// half of it for the magnets that should meet and half for the blocks. Each half is the mean of `1 − tanh(d / 0.4 m)`
/// and `1 − θ/π`. Every other connection costs `wrong_weight`, unused blocks included, and every heavy contact costs
/// `heavy_contact_weight`, up to 1 in total.
pub fn potential(scene: &Scene, blueprint: &Blueprint, config: &RewardConfig) -> RewardTerms {
    let mut terms = RewardTerms::default();
    for joint in &scene.joints {
        if joint.is_right(blueprint) {
            terms.connected += 1.0;
        } else {
            terms.wrong -= config.wrong_weight;
        }
    }
    for link in blueprint.links() {
        let [a, b] = linked_poses(scene, link);
        terms.magnets += 0.5 * config.dense_weight * magnet_misfit(&a, &b, link).closeness();
        terms.blocks += 0.5 * config.dense_weight * block_misfit(&a, &b, link).closeness();
    }
    let heavy = config.heavy_contact_weight * f32::from(scene.n_heavy_contacts);
    terms.force = -heavy.min(HEAVY_CONTACT_CAP);
    terms
}

/// Returns the reward of a step from the potentials before and after it.
pub fn reward(before: &RewardTerms, after: &RewardTerms) -> RewardTerms {
    RewardTerms {
        connected: after.connected - before.connected,
        wrong: after.wrong - before.wrong,
        magnets: after.magnets - before.magnets,
        blocks: after.blocks - before.blocks,
        force: after.force - before.force,
    }
}

/// Distance (m) and angle (rad) to a target pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Misfit {
    pub(crate) distance: f32,
    pub(crate) angle: f32,
}

impl Misfit {
    fn closeness(self) -> f32 {
        0.5 * (1.0 - (self.distance / DISTANCE_SCALE_M).tanh()) + 0.5 * (1.0 - self.angle / std::f32::consts::PI)
    }
}

/// Returns the poses of two blocks that are to be connected.
pub(crate) fn linked_poses(scene: &Scene, link: &Link) -> [Isometry3<f32>; 2] {
    [link.a, link.b].map(|block| from_pose(&scene.blocks[block.get()]))
}

/// Returns the misfit of two blocks. The distance of each center from its target is relative to the other block; this
/// is the mean.
pub(crate) fn block_misfit(a: &Isometry3<f32>, b: &Isometry3<f32>, link: &Link) -> Misfit {
    let wanted = link.relative.rotation.quaternion();
    // Relative to one block only, the distance of a distant pair would depend on which of the two has the lower number.
    let seen_from_a = a.inverse_transform_vector(&(b.translation.vector - a.translation.vector));
    let from_a = (seen_from_a - link.relative.position_m()).norm();
    let seen_from_b = b.inverse_transform_vector(&(a.translation.vector - b.translation.vector));
    let from_b = (seen_from_b - link.relative.inverse().position_m()).norm();
    Misfit { distance: 0.5 * (from_a + from_b), angle: wanted.angle_to(&(a.rotation.inverse() * b.rotation)) }
}

/// Returns the mean misfit of the magnet pairs that should meet.
fn magnet_misfit(a: &Isometry3<f32>, b: &Isometry3<f32>, link: &Link) -> Misfit {
    let inventory = Inventory::standard();
    let (magnets_a, magnets_b) = (inventory.magnets(link.a), inventory.magnets(link.b));
    let pairs = inventory.magnet_pairs(link.a, link.b, link.relative);
    let mut sum = Misfit { distance: 0.0, angle: 0.0 };
    for &(i, j) in &pairs {
        let (magnet_a, magnet_b) = (&magnets_a[i], &magnets_b[j]);
        let point_a = a.transform_point(&magnet_position_m(magnet_a).into());
        let point_b = b.transform_point(&magnet_position_m(magnet_b).into());
        sum.distance += (point_a - point_b).norm();
        let normal =
            |rotation: &nalgebra::UnitQuaternion<f32>, n: [i32; 3]| rotation * Vector3::from(n.map(|x| x as f32));
        // Magnets that meet face each other.
        sum.angle += normal(&a.rotation, magnet_a.normal).angle(&-normal(&b.rotation, magnet_b.normal));
    }
    let n = pairs.len().max(1) as f32;
    Misfit { distance: sum.distance / n, angle: sum.angle / n }
}

//! Where to build: on free ground, away from the other blocks.

use blueprints::{BlockIdx, Placement};
use nalgebra::{Isometry3, Point3, Vector2, Vector3};

use super::view::View;
use super::{Base, Expert};

/// Maximum structure radius for which the expert looks for room, m.
const MAX_RADIUS_M: f32 = 0.25;
/// Room for a block beside the structure, and for the part of the structure beyond its blocks' centers, m.
const STRAY_RADIUS_M: f32 = 0.25;
/// Weight of the push from nearby blocks, relative to the outward push.
const PUSH_WEIGHT: f32 = 0.7;
/// Number of nearby blocks, weighted by proximity, at which the outward push has its full weight.
const CROWD: f32 = 1.5;

impl Expert {
    /// Returns the center of the finished structure in the blueprint's frame, m, and the distance, seen from
    /// above, from it to the farthest block's center, m.
    fn extent_m(&self, side: usize) -> (Vector3<f32>, f32) {
        let placements = self.blueprint.placements();
        let sum: Vector3<f32> = placements.iter().map(Placement::position_m).sum();
        let middle = sum / placements.len() as f32;
        let up = self.assembly.up(side);
        let across = |placement: &Placement| {
            let away = placement.position_m() - middle;
            (0..3).filter(|&axis| up[axis] == 0).map(|axis| away[axis].powi(2)).sum::<f32>().sqrt()
        };
        (middle, placements.iter().map(across).fold(0.0, f32::max))
    }

    /// Returns where the center of the finished structure would be.
    pub(super) fn middle(&self, frame: &Isometry3<f32>, side: usize) -> [f32; 2] {
        let middle = frame * Point3::from(self.extent_m(side).0);
        [middle.x, middle.y]
    }

    /// Returns the frame set down so that the center of the finished structure is at `xy`.
    pub(super) fn frame_at(&self, frame: &Isometry3<f32>, side: usize, xy: [f32; 2]) -> Isometry3<f32> {
        let at_origin = self.set_down(frame, side, [0.0, 0.0]);
        let middle = self.middle(&at_origin, side);
        self.set_down(frame, side, [xy[0] - middle[0], xy[1] - middle[1]])
    }

    /// Returns the direction in which nearby blocks push the base, as a unit vector; `None` if there is room for the
    /// structure.
    ///
    /// In a crowd, it points away from the mean of all strays and around nearby ones. With few blocks nearby, it points
    /// away from those. It changes smoothly with the scene, so a policy can imitate it, unlike a search over the whole
    /// ground.
    pub(super) fn push(&self, view: &View, base: &Base) -> Option<Vector2<f32>> {
        let here = Vector2::from(self.middle(&base.frame, base.side));
        let reach = self.extent_m(base.side).1.min(MAX_RADIUS_M) + STRAY_RADIUS_M;
        let strays = BlockIdx::all()
            // Held blocks are on their way somewhere.
            .filter(|&block| !view.is_held(block))
            .filter(|block| !view.part_of[block.get()].is_some_and(|part| base.parts.contains(part)));
        let away: Vec<Vector2<f32>> = strays.map(|stray| here - view.pose(stray).translation.vector.xy()).collect();
        let near = |away: &&Vector2<f32>| away.norm() < reach;
        let push: Vector2<f32> =
            away.iter().filter(near).map(|away| away * ((reach - away.norm()) / reach / away.norm().max(1e-3))).sum();
        let crowd: f32 = away.iter().filter(near).map(|away| 1.0 - away.norm() / reach).sum();
        let all: Vector2<f32> = away.iter().sum();
        let outwards = all.try_normalize(1e-3).unwrap_or_else(Vector2::x) * (crowd / CROWD).min(1.0);
        // In a crowd, nearby blocks deflect the direction but never reverse it.
        let aside = push * (PUSH_WEIGHT / push.norm().max(1.0));
        (crowd > 0.0).then(|| (outwards + aside).try_normalize(1e-3).unwrap_or_else(Vector2::x))
    }
}

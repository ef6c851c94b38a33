//! Where to build: a free piece of ground, not far from anything.

use blueprints::{BlockIdx, UNIT_M};
use nalgebra::{Isometry3, Vector2, Vector3};

use super::motion::gap;
use super::view::View;
use super::{Base, Expert};

/// Sites lie on a grid of this spacing, m.
const SPACING_M: f32 = 0.1;
/// Sites lie at most so many grid steps from the origin in x and y.
const REACH: i32 = 13;
/// Free space wanted around the finished structure, m.
const CLEARANCE_M: f32 = 0.03;
/// How far the blocks in the way push the site at a time, m, and how often at most.
const PUSH_M: f32 = 0.05;
const MAX_PUSHES: usize = 30;
/// What it costs to carry the base by a metre, and to have a block in the way, in metres of other carrying.
const CLUTTER_COST: f32 = 1.0;
/// What it costs if the base itself has no room, in the same unit.
const BLOCKED_COST: f32 = 30.0;

impl Expert {
    /// Middle of the finished structure's ground plan, blueprint frame.
    fn middle_of_plan(&self, side: usize) -> Vector3<f32> {
        let placements = self.blueprint.placements();
        let sum: Vector3<f32> = placements.iter().map(|p| p.position_m()).sum();
        let mean = sum / placements.len() as f32;
        let up = self.up(side);
        mean - up * up.dot(&mean)
    }

    /// Where the middle of the finished structure would be.
    pub(super) fn middle(&self, frame: &Isometry3<f32>, side: usize) -> [f32; 2] {
        let middle = frame * nalgebra::Point3::from(self.middle_of_plan(side));
        [middle.x, middle.y]
    }

    /// The frame set down so that the middle of the finished structure is at `xy`.
    pub(super) fn frame_at(&self, frame: &Isometry3<f32>, side: usize, xy: [f32; 2]) -> Isometry3<f32> {
        let at_origin = self.set_down(frame, side, [0.0, 0.0]);
        let middle = self.middle(&at_origin, side);
        self.set_down(frame, side, [xy[0] - middle[0], xy[1] - middle[1]])
    }

    /// The place for the middle of the structure: the present one if that is free, else where the blocks in the way push
    /// it; where they push back and forth, the best one on the ground.
    ///
    /// The best one depends on the base only through its distance, so that it stays the best while the base moves there.
    pub(super) fn site(&self, view: &View, base: &Base) -> [f32; 2] {
        let here = self.middle(&base.frame, base.side);
        let strays: Vec<BlockIdx> = BlockIdx::all()
            // What is held is on its way somewhere.
            .filter(|&block| !view.is_held(block))
            .filter(|block| !view.part_of[block.get()].is_some_and(|part| base.parts.contains(part)))
            .collect();
        let lies = self.lift_m(&base.frame, base.side).abs() <= super::MAX_LIFT_M;
        let here_frame = self.frame_at(&base.frame, base.side, here);
        // Also when it hangs above: where it is to go should not depend on how it got there.
        if self.n_in_the_way(view, &here_frame, &strays) == 0 {
            return here;
        }
        if let Some(site) = self.pushed_away(view, base, here, &strays) {
            return site;
        }
        let parts: Vec<_> = strays.iter().filter(|b| view.part_of[b.get()].is_some()).collect();
        let n = parts.len().max(1) as f32;
        let center = parts.iter().map(|b| view.pose(**b).translation.vector).sum::<Vector3<f32>>() / n;
        let mut sites: Vec<(f32, [f32; 2])> = Vec::new();
        for x in -REACH..=REACH {
            for y in -REACH..=REACH {
                let xy = [x as f32 * SPACING_M, y as f32 * SPACING_M];
                let far = |p: [f32; 2]| (xy[0] - p[0]).hypot(xy[1] - p[1]);
                sites.push((far(here) + 0.5 * n * far([center.x, center.y]), xy));
            }
        }
        sites.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut best = (f32::INFINITY, here);
        for (cost, xy) in sites {
            if cost >= best.0 {
                break;
            }
            let frame = self.frame_at(&base.frame, base.side, xy);
            let own = base.parts.iter().any(|part| {
                let place = frame * self.place(part);
                let half = &view.half_extents[self.block(part).get()];
                strays.iter().any(|s| gap((&place, half), (view.pose(*s), &view.half_extents[s.get()])) < CLEARANCE_M)
            });
            let blocked = if own { BLOCKED_COST } else { 0.0 };
            let total = cost + blocked + CLUTTER_COST * self.n_in_the_way(view, &frame, &strays) as f32;
            if total < best.0 {
                best = (total, xy);
            }
        }
        let [x, y] = best.1;
        // Near enough is there: a grid point is never hit exactly.
        if lies && (x - here[0]).hypot(y - here[1]) < 0.6 * SPACING_M { here } else { best.1 }
    }

    /// The nearest free place in the direction in which the blocks in the way push; `None` if they push back and forth.
    ///
    /// Each push depends on what is near alone, so that it can be imitated, unlike a search over the whole ground.
    fn pushed_away(&self, view: &View, base: &Base, here: [f32; 2], strays: &[BlockIdx]) -> Option<[f32; 2]> {
        let mut at = here;
        for _ in 0..MAX_PUSHES {
            let frame = self.frame_at(&base.frame, base.side, at);
            let mut push = Vector2::zeros();
            for stray in self.in_plan(view, &frame, strays) {
                let from = view.pose(stray).translation.vector.xy();
                push += (Vector2::from(at) - from).try_normalize(1e-3).unwrap_or_else(Vector2::x);
            }
            if push == Vector2::zeros() {
                return Some(at);
            }
            let step = push.try_normalize(1e-3)? * PUSH_M;
            at = [at[0] + step.x, at[1] + step.y];
        }
        None
    }

    /// Number of blocks where the finished structure of `frame` is to be.
    fn n_in_the_way(&self, view: &View, frame: &Isometry3<f32>, strays: &[BlockIdx]) -> usize {
        self.in_plan(view, frame, strays).count()
    }

    /// The blocks where the finished structure of `frame` is to be.
    fn in_plan<'s>(
        &'s self,
        view: &'s View,
        frame: &'s Isometry3<f32>,
        strays: &'s [BlockIdx],
    ) -> impl Iterator<Item = BlockIdx> + 's {
        let inside = move |block: &BlockIdx| {
            let (pose, half) = (view.pose(*block), &view.half_extents[block.get()]);
            (0..self.blueprint.n_blocks()).any(|part| {
                let place = frame * self.place(part);
                let own = &view.half_extents[self.block(part).get()];
                gap((&place, own), (pose, half)) < CLEARANCE_M
            })
        };
        strays.iter().copied().filter(inside)
    }

    /// Length of a way in, m.
    pub(super) fn way_m(direction: [i32; 3], length_half_units: i32) -> Vector3<f32> {
        Vector3::from(direction.map(|x| x as f32)) * (length_half_units as f32 * UNIT_M / 2.0)
    }
}

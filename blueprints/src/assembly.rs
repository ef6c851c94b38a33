//! Assembly orders: which part can be added next, and along which approach path.
//!
//! A structure is built on any of its six sides; success does not depend on the side. The builder cannot support the
//! other parts, so every intermediate structure must stand on its own. A part must not pass through another one or
//! slide along a face whose magnets would catch it one cell early.

mod geometry;
mod shared;

use std::collections::BTreeMap;

use geometry::Geometry;
pub use geometry::{Approach, Parts};
pub(crate) use shared::Shared;

use crate::{BlockIdx, Placement};

/// Minimum support margin of an intermediate structure, in units.
pub const MIN_BUILD_MARGIN_U: f64 = 0.15;

/// Margin in units above which sides rank equally.
const AMPLE_MARGIN_U: f64 = 0.35;

/// Maximum number of intermediate structures that a search visits on one side.
const MAX_VISITS: usize = 4000;

/// No assembly order was found.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}: blocks {missing:?} are never reached", impossible(*gave_up))]
pub struct NoAssembly {
    /// The blocks missing from the largest structure that the search reached on any side.
    pub missing: Vec<BlockIdx>,
    /// Whether the search visited too many structures on some side to prove that there is no order.
    pub gave_up: bool,
}

/// Says that no order was found, and whether there may be one.
pub(crate) fn impossible(gave_up: bool) -> &'static str {
    if gave_up {
        "the search for an order in which it can be put together block by block gave up"
    } else {
        "whichever side it lies on, it cannot be put together block by block"
    }
}

/// The assembly orders of a blueprint. Queries take `&mut self` to cache results that depend only on the blueprint.
#[derive(Clone, Debug)]
pub struct Assembly {
    geometry: Geometry,
    blocks: Vec<BlockIdx>,
    /// Sides with a complete assembly order, best first.
    sides: Vec<Side>,
}

/// Assembly orders with one direction of the blueprint's frame pointing up.
#[derive(Clone, Debug)]
struct Side {
    up: [i32; 3],
    /// Whether the structure can be completed from each set of placed parts.
    safe: BTreeMap<Parts, bool>,
    /// The largest structure reached.
    furthest: Parts,
    /// Whether a search ended at [`MAX_VISITS`].
    gave_up: bool,
}

impl Side {
    fn new(up: [i32; 3]) -> Self {
        Self { up, safe: BTreeMap::new(), furthest: Parts::default(), gave_up: false }
    }
}

impl Assembly {
    pub(crate) fn of_placements(placements: &[Placement]) -> Result<Self, NoAssembly> {
        let geometry = Geometry::new(placements);
        let blocks = placements.iter().map(|p| p.block).collect();
        let mut ranked = Vec::new();
        let mut furthest = Parts::default();
        let mut gave_up = false;
        for up in UPS {
            let mut side = Side::new(up);
            if let Some(margin_u) = side.least_margin(&geometry) {
                let ample = margin_u.min(AMPLE_MARGIN_U);
                ranked.push((ample - 0.05 * f64::from(geometry.height(up)), side));
            } else {
                gave_up |= side.gave_up;
                if side.furthest.len() > furthest.len() {
                    furthest = side.furthest;
                }
            }
        }
        // The sort is stable, so the drawing's own up direction wins ties.
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
        let sides: Vec<Side> = ranked.into_iter().map(|(_, side)| side).collect();
        if sides.is_empty() {
            let missing = geometry.all().without(furthest).iter().map(|part| placements[part].block).collect();
            return Err(NoAssembly { missing, gave_up });
        }
        Ok(Self { geometry, blocks, sides })
    }

    /// Returns whether the placements can be built on some side. Does not rank the sides, so it is several times as
    /// fast as finding the orders.
    pub fn is_possible(placements: &[Placement]) -> bool {
        let geometry = Geometry::new(placements);
        UPS.into_iter().any(|up| Side::new(up).is_safe(&geometry, Parts::default()))
    }

    /// Returns the blocks by part index.
    pub fn blocks(&self) -> &[BlockIdx] {
        &self.blocks
    }

    /// Returns the number of sides on which the structure can be built, at least 1. Side 0 is the best.
    pub fn n_sides(&self) -> usize {
        self.sides.len()
    }

    /// Returns the direction of the blueprint's frame that points up on a side.
    pub fn up(&self, side: usize) -> [i32; 3] {
        self.sides[side].up
    }

    /// Returns the height, in half units along a side's up direction, of the plane on which the finished structure
    /// rests.
    pub fn ground_half_units(&self, side: usize) -> i32 {
        self.geometry.ground(self.sides[side].up)
    }

    /// Returns whether a part touches the ground in the finished structure.
    pub fn is_at_bottom(&self, side: usize, part: usize) -> bool {
        self.geometry.boxes[part].bottom(self.sides[side].up) == self.ground_half_units(side)
    }

    /// Returns whether the structure can be completed from `placed` on that side.
    pub fn is_safe(&mut self, side: usize, placed: Parts) -> bool {
        self.sides[side].is_safe(&self.geometry, placed)
    }

    /// Returns the approach paths for `group` to the structure `placed`, best first.
    pub fn approaches(&self, side: usize, placed: Parts, group: Parts) -> impl Iterator<Item = Approach> {
        self.geometry.approaches(placed, group, self.sides[side].up)
    }

    /// Returns the best approach path for `group` to the structure `placed`; `None` if there is none.
    pub fn approach(&self, side: usize, placed: Parts, group: Parts) -> Option<Approach> {
        self.approaches(side, placed, group).next()
    }

    /// Returns the support margin of `placed` in units; negative if it would tip over.
    pub fn margin_u(&self, side: usize, placed: Parts) -> f64 {
        self.geometry.margin_u(placed, self.sides[side].up)
    }

    /// Returns the best part to place next; `None` if all parts are placed or no assembly order continues from here.
    pub fn next(&mut self, side: usize, placed: Parts) -> Option<usize> {
        self.sides[side].next(&self.geometry, placed)
    }
}

const UPS: [[i32; 3]; 6] = [[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, -1]];

impl Side {
    /// Returns the parts that can be added now, best first: lower parts, then those that keep the structure more
    /// stable, then larger ones.
    fn candidates(&self, geometry: &Geometry, placed: Parts) -> Vec<usize> {
        let mut found: Vec<(i32, i64, i32, usize)> = Vec::new();
        for part in geometry.all().without(placed).iter() {
            let group = Parts::one(part);
            if !placed.is_empty() && geometry.approaches(placed, group, self.up).next().is_none() {
                continue;
            }
            let margin_u = geometry.margin_u(placed.with(part), self.up);
            if margin_u >= MIN_BUILD_MARGIN_U {
                let firmness = (margin_u.min(AMPLE_MARGIN_U) * 20.0).round() as i64;
                let own = &geometry.boxes[part];
                found.push((own.bottom(self.up), -firmness, -own.volume(), part));
            }
        }
        found.sort_unstable();
        found.into_iter().map(|(.., part)| part).collect()
    }

    fn next(&mut self, geometry: &Geometry, placed: Parts) -> Option<usize> {
        self.candidates(geometry, placed).into_iter().find(|&part| self.is_safe(geometry, placed.with(part)))
    }

    fn is_safe(&mut self, geometry: &Geometry, placed: Parts) -> bool {
        let mut visits = MAX_VISITS;
        self.search(geometry, placed, &mut visits)
    }

    fn search(&mut self, geometry: &Geometry, placed: Parts, visits: &mut usize) -> bool {
        if placed == geometry.all() {
            return true;
        }
        if let Some(&known) = self.safe.get(&placed) {
            return known;
        }
        if placed.len() > self.furthest.len() {
            self.furthest = placed;
        }
        // Without this, the search would visit every structure that can be built around a part that is shut out.
        if geometry.all().without(placed).iter().any(|part| geometry.is_shut_out(placed, part, self.up)) {
            return false;
        }
        if *visits == 0 {
            self.gave_up = true;
            return false;
        }
        *visits -= 1;
        let candidates = self.candidates(geometry, placed);
        let safe = candidates.into_iter().any(|part| self.search(geometry, placed.with(part), visits));
        // A search that was cut short proves nothing, so do not cache it.
        if safe || *visits > 0 {
            self.safe.insert(placed, safe);
        }
        safe
    }

    /// Returns the minimum support margin along the preferred order; `None` if there is no order.
    fn least_margin(&mut self, geometry: &Geometry) -> Option<f64> {
        let mut placed = Parts::default();
        let mut least = f64::INFINITY;
        if !self.is_safe(geometry, placed) {
            return None;
        }
        while placed != geometry.all() {
            placed = placed.with(self.next(geometry, placed)?);
            least = least.min(geometry.margin_u(placed, self.up));
        }
        Some(least)
    }
}

#[cfg(test)]
pub(crate) mod tests;

//! Contacts, approach paths, and support of boxes on the lattice.

use crate::stance::support_margin;
use crate::{N_BLOCKS, Placement};

/// Minimum approach length in half units; a path starts out of reach of every magnet but its targets.
const MIN_APPROACH: i32 = 3;
/// Maximum approach length in half units.
const MAX_APPROACH: i32 = 14;
/// Free height required above the start of the approach, in half units; more than the tallest structure of 16 blocks.
const SKY: i32 = 80;

/// A set of parts. A part is a placement's index in the blueprint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Parts(u16);

/// A straight approach path to a part's place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Approach {
    /// Direction from the place to the start of the path, blueprint frame; entries −1, 0, and 1.
    pub direction: [i32; 3],
    /// Path length as a multiple of `direction`, in half units (0.05 m).
    pub length_half_units: i32,
}

/// The parts as boxes in half units.
#[derive(Clone, Debug)]
pub(super) struct Geometry {
    pub(super) boxes: Vec<Box3>,
    /// For each part and direction (+x −x +y −y +z −z), the parts whose face in that direction touches it: if part `j`
    /// is in `contacts[i][d]`, then `i` lies in direction `d` from `j`.
    contacts: Vec<[Parts; 6]>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Box3 {
    low: [i32; 3],
    high: [i32; 3],
}

impl Parts {
    /// Returns the set of one part.
    pub fn one(part: usize) -> Self {
        Self(1 << part)
    }

    /// Returns the set of parts `0..n`, `n` up to 16.
    pub fn first(n: usize) -> Self {
        debug_assert!(n <= N_BLOCKS);
        Self(((1_u32 << n) - 1) as u16)
    }

    /// Returns whether the set is empty.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Returns the number of parts.
    pub fn len(self) -> usize {
        self.0.count_ones() as usize
    }

    /// Returns whether the set contains the part.
    pub fn contains(self, part: usize) -> bool {
        self.0 & (1 << part) != 0
    }

    /// Returns the set with `part` added.
    #[must_use]
    pub fn with(self, part: usize) -> Self {
        Self(self.0 | (1 << part))
    }

    /// Returns the union of the two sets.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// Returns the parts that are not in `other`.
    #[must_use]
    pub fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// Iterates over the parts in increasing order.
    pub fn iter(self) -> impl Iterator<Item = usize> {
        (0..N_BLOCKS).filter(move |&part| self.contains(part))
    }
}

impl Geometry {
    pub(super) fn new(placements: &[Placement]) -> Self {
        let boxes: Vec<Box3> = placements.iter().map(Box3::of).collect();
        let contacts = (0..boxes.len())
            .map(|i| {
                let mut sides = [Parts::default(); 6];
                for (j, other) in boxes.iter().enumerate().filter(|&(j, _)| j != i) {
                    if let Some(d) = boxes[i].side_of(other) {
                        sides[d] = sides[d].with(j);
                    }
                }
                sides
            })
            .collect();
        Self { boxes, contacts }
    }

    pub(super) fn all(&self) -> Parts {
        Parts::first(self.boxes.len())
    }

    /// Returns the lowest point of the finished structure along `up`, in half units.
    pub(super) fn ground(&self, up: [i32; 3]) -> i32 {
        self.boxes.iter().map(|b| b.bottom(up)).min().unwrap_or(0)
    }

    /// Returns the height of the finished structure along `up`, in units.
    pub(super) fn height(&self, up: [i32; 3]) -> i32 {
        let down = up.map(|x| -x);
        let top = self.boxes.iter().map(|b| -b.bottom(down)).max().unwrap_or(0);
        (top - self.ground(up)) / 2
    }

    /// Returns the support margin of the parts `placed`, in units, as one rigid body on the ground plane of the
    /// finished structure; negative if they would tip, −∞ if none touches the plane.
    pub(super) fn margin_u(&self, placed: Parts, up: [i32; 3]) -> f64 {
        let ground = self.ground(up);
        let axis = axis_of(up);
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut corners = Vec::with_capacity(4 * placed.len());
        let mut volume = 0;
        let mut moment = [0, 0];
        for part in placed.iter() {
            let b = &self.boxes[part];
            volume += b.volume();
            // Twice the moment, to keep it an integer.
            moment[0] += b.volume() * (b.low[u] + b.high[u]);
            moment[1] += b.volume() * (b.low[v] + b.high[v]);
            if b.bottom(up) == ground {
                for x in [b.low[u], b.high[u]] {
                    corners.extend([[x, b.low[v]], [x, b.high[v]]]);
                }
            }
        }
        if corners.is_empty() {
            return f64::NEG_INFINITY;
        }
        let center = moment.map(|m| f64::from(m) / f64::from(2 * volume));
        // Half units to units.
        support_margin(corners, center) / 2.0
    }

    /// Returns the straight approach paths for `group`, moved as one rigid body, to the structure `placed`, best first.
    ///
    /// Moving outward, the group leaves every face that it touches, so no two of these faces may face each other. It
    /// does not approach from below. The space above the group is free at the start of the path.
    pub(super) fn approaches(&self, placed: Parts, group: Parts, up: [i32; 3]) -> impl Iterator<Item = Approach> {
        self.directions(placed, group, up).into_iter().filter_map(move |direction| {
            let length_half_units = self.free_path(placed, group, direction, up)?;
            Some(Approach { direction, length_half_units })
        })
    }

    /// Returns whether the part can be added neither to `placed` nor to anything built on it: it would be between two
    /// placed parts, or hang below one.
    pub(super) fn is_shut_out(&self, placed: Parts, part: usize, up: [i32; 3]) -> bool {
        is_blocked(self.touched(placed, Parts::one(part)), up)
    }

    /// Returns on which sides a group touches `placed`: entry `d` is whether it lies in direction `d` from a part.
    fn touched(&self, placed: Parts, group: Parts) -> [bool; 6] {
        let mut sides = [false; 6];
        for part in group.iter() {
            for (side, others) in sides.iter_mut().zip(&self.contacts[part]) {
                *side |= others.without(placed) != *others;
            }
        }
        sides
    }

    /// Returns the directions in which a group can leave every face that it touches.
    fn directions(&self, placed: Parts, group: Parts, up: [i32; 3]) -> Vec<[i32; 3]> {
        let sides = self.touched(placed, group);
        if is_blocked(sides, up) || sides.iter().all(|&side| !side) {
            return Vec::new();
        }
        let away: [i32; 3] = std::array::from_fn(|axis| i32::from(sides[2 * axis]) - i32::from(sides[2 * axis + 1]));
        let mut ways: Vec<[i32; 3]> = Vec::with_capacity(6);
        let is_up = |d: [i32; 3]| (0..3).map(|k| d[k] * up[k]).sum::<i32>() > 0;
        if is_up(away) {
            ways.push(away);
        } else {
            ways.extend([add(away, up), away]);
        }
        for axis in (0..3).filter(|&axis| away[axis] == 0 && axis != axis_of(up)) {
            for sign in [1, -1] {
                let mut way = away;
                way[axis] = sign;
                ways.push(if is_up(way) { way } else { add(way, up) });
            }
        }
        ways
    }

    /// Returns the path length after which a group moved along `direction` is clear of `placed` with free space above
    /// it.
    ///
    /// Along the path, only the faces that the group touches come closer than a half unit, because the wrong magnets
    /// would catch a face that slides along another one.
    fn free_path(&self, placed: Parts, group: Parts, direction: [i32; 3], up: [i32; 3]) -> Option<i32> {
        let hits = |b: Box3| placed.iter().any(|other| b.overlaps(&self.boxes[other]));
        for t in 1..=MAX_APPROACH {
            let moved = |part: usize| self.boxes[part].moved(direction.map(|x| x * t));
            // After one half unit, a face that passes another one is offset by half a cell, so no magnets meet.
            let room = i32::from(t > 1);
            if group.iter().any(|part| hits(moved(part).grown(room))) {
                return None;
            }
            if t >= MIN_APPROACH && !group.iter().any(|part| hits(moved(part).grown(1).stretched(up, SKY))) {
                return Some(t);
            }
        }
        None
    }
}

impl Box3 {
    fn of(placement: &Placement) -> Self {
        let size = placement.size_cells();
        let corner = |sign: i32| std::array::from_fn(|k| placement.center_half_units[k] + sign * size[k]);
        Self { low: corner(-1), high: corner(1) }
    }

    /// Returns the volume in eighths of a cell.
    pub(super) fn volume(&self) -> i32 {
        (0..3).map(|k| self.high[k] - self.low[k]).product()
    }

    /// Returns the lowest point along `up`, in half units.
    pub(super) fn bottom(&self, up: [i32; 3]) -> i32 {
        let axis = axis_of(up);
        if up[axis] > 0 { self.low[axis] } else { -self.high[axis] }
    }

    fn moved(&self, by: [i32; 3]) -> Self {
        Self { low: add(self.low, by), high: add(self.high, by) }
    }

    fn grown(&self, by: i32) -> Self {
        Self { low: self.low.map(|x| x - by), high: self.high.map(|x| x + by) }
    }

    /// Extends the box by `length` in a direction.
    fn stretched(&self, direction: [i32; 3], length: i32) -> Self {
        let by = direction.map(|x| x * length);
        Self { low: add(self.low, by.map(|x| x.min(0))), high: add(self.high, by.map(|x| x.max(0))) }
    }

    fn overlaps(&self, other: &Self) -> bool {
        (0..3).all(|k| self.low[k] < other.high[k] && other.low[k] < self.high[k])
    }

    /// Returns the direction from `other` to this box if they share part of a face.
    fn side_of(&self, other: &Self) -> Option<usize> {
        let overlap = |k: usize| self.high[k].min(other.high[k]) - self.low[k].max(other.low[k]);
        let axis = (0..3).find(|&k| overlap(k) == 0)?;
        let shares = (0..3).all(|k| k == axis || overlap(k) > 0);
        shares.then(|| 2 * axis + usize::from(self.low[axis] < other.low[axis]))
    }
}

/// Returns whether faces touched on these sides (+x −x +y −y +z −z) leave no straight way out, except from below.
fn is_blocked(sides: [bool; 6], up: [i32; 3]) -> bool {
    let is_squeezed = (0..3).any(|axis| sides[2 * axis] && sides[2 * axis + 1]);
    let axis = axis_of(up);
    is_squeezed || sides[2 * axis + usize::from(up[axis] > 0)]
}

fn axis_of(direction: [i32; 3]) -> usize {
    direction.iter().position(|&x| x != 0).unwrap_or(0)
}

fn add(a: [i32; 3], b: [i32; 3]) -> [i32; 3] {
    std::array::from_fn(|k| a[k] + b[k])
}

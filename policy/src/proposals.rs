//! Proposals: the moves of a scene from which the mixture head draws.
//!
//! Every block i has a short list of moves that may make sense. The policy chooses one of them, and the move is drawn
//! around it with noise that grows with the move. What is proposed is a function of scene and blueprint.
//!
//! ```text
//!  join j, not aligned          join j, aligned               detach j
//!
//!       ┌───┐ → ╮                  ┌───┐  both come,          ┌───┐ ↗  pull, lift,
//!       │ i │    ╲ the funnel      │ i │ ↘ each its           │ i │↻   bend, twist
//!       └───┘     ↓                └───┘   part               └───┘
//!              ┌─────┐                 ↖ ┌─────┐              ┌─────┐
//!              │  j  │ waits             │  j  │              │  j  │
//!              └─────┘                   └─────┘              └─────┘
//!
//!  hold: rise to half a meter
//! ```
//!
//! | kind | of | the move of i | proposed if |
//! |---|---|---|---|
//! | [`Join`](Kind::Join) | each j | its part of the way to its place relative to j; through the funnel until it is aligned | the blueprint connects the two, nothing does yet, and no wrong connection makes them move together |
//! | [`Detach`](Kind::Detach) | each j | away from j, a little up, and turning | the two are connected, but not as the blueprint wants it |
//! | [`Hold`](Kind::Hold) | i | up to half a meter above the ground; nothing if it is higher | always |
//!
//! **The funnel.** On the way to its place, i stays off j in the direction in which their pieces part most freely (or
//! along the normal of the connection, if they belong to one piece already): the farther it will be from the axis after
//! this step, and the more it will have to turn, the farther off. Once i is aligned, the funnel ends, and the move goes a
//! little too far: magnets snap before the blocks touch, and they do so in this step instead of the next.
//!
//! **Turning.** A block that touches another and has to turn first backs off as far as it needs for that. Otherwise, it
//! would press against both walls of a corner forever.
//!
//! **The detour.** If blocks of other pieces are between i and that point, i goes around them (`detour.rs`): straight
//! ways through a structure were what broke most of its connections.
//!
//! **Parts of the way.** Of two pieces, the larger one waits until the smaller one is aligned, so high that there is room
//! below the place where the other will be. Then both come, and the larger one goes a smaller part of the way. Pieces of
//! one size go half of the way from the start. Where there is only one gripper, its block goes all the way.
//!
//! All moves are velocities as fractions of the world's limits, as in [`Action`](proto::Action). A move that would take
//! more than one step is scaled down, so that shift and turn arrive together.

use std::cell::OnceCell;
use std::ops::Range;

use blueprints::{BlockIdx, Blueprint, Inventory, Link, N_BLOCKS};
use nalgebra::{Rotation3, Vector3};
use proto::{Move, Observation, Scene};

use crate::detour::next_stop;
use crate::geometry::{Frame, matrix, rotation_vector};
use crate::openings::{Cell, Shape, opening};
use crate::solid::Solid;

const N: usize = N_BLOCKS;

/// Number of slots of a block: one for each kind and partner, and one for each kind without a partner.
pub const N_SLOTS: usize = Kind::PAIRED.len() * N + Kind::ALONE.len();

/// Number of entries of a [relation](Proposals::relation).
pub const N_RELATION: usize = 8;

/// Reach of one step at full speed, m: 3 m/s for 0.1 s.
const STEP_M: f32 = 0.3;
/// Reach of one step at full speed, rad: 2π rad/s for 0.1 s.
const STEP_RAD: f32 = 0.2 * std::f32::consts::PI;

/// Standard deviation of a move, as a fraction of the limits: constant part, and factor of its largest entry. The sum
/// at full speed is 9 mm; magnets snap within 3 cm.
const NOISE: [f32; 2] = [0.01, 0.02];

/// Longest distance from the place in the funnel of two single blocks, m.
const FUNNEL_M: f32 = 0.2;
/// Distance per lateral distance beyond 1 cm.
const FUNNEL_SLOPE: f32 = 2.0;
/// Distance from the axis at which two blocks count as aligned, m.
const ALIGNED_M: f32 = 0.01;
/// Distance in the funnel per radian of turn, m, for single blocks; larger pieces need their radius more.
const FUNNEL_PER_RAD: f32 = 0.15;
/// Turn at which two blocks count as aligned, rad.
const ALIGNED_RAD: f32 = 0.1;
/// The part of the funnel that no step skips, m, and what it grows by with the radius of the pieces.
const NEAR_M: f32 = 0.12;
const NEAR_PER_RADIUS: f32 = 0.5;
/// How much too far an aligned block goes, m.
const PRESS_M: f32 = 0.02;
/// Distance at which blocks touch, m.
const TOUCH_M: f32 = 0.015;
/// Steps and end of the search for room to turn, m.
const BACK_OFF_M: [f32; 2] = [0.05, 0.8];
/// Overlap at which a turning block still has room, m.
const SLACK_M: f32 = 0.003;
/// Entry 5 of a relation from which on both pieces come.
const BOTH_COME: f32 = 0.5;

/// Height to which a held block, or the place of a block that is to come to it, rises, m: room for other blocks below.
const HOLD_M: f32 = 0.5;
/// Pull and lift of `Detach`, as fractions of the speed limit.
const PULL: f32 = 0.4;
const PULL_UP: f32 = 0.06;

/// What a proposal does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// Comes to its place relative to a partner.
    Join,
    /// Breaks a wrong connection with a partner.
    Detach,
    /// Stays, above the ground.
    Hold,
}

impl Kind {
    /// The kinds with a partner, in the order of their slots.
    pub const PAIRED: [Self; 2] = [Self::Join, Self::Detach];
    /// The kinds without a partner, in the order of their slots.
    pub const ALONE: [Self; 1] = [Self::Hold];
    /// All kinds.
    pub const ALL: [Self; 3] = [Self::Join, Self::Detach, Self::Hold];

    /// Returns the name, as in metrics: `join`, `detach`, or `hold`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Join => "join",
            Self::Detach => "detach",
            Self::Hold => "hold",
        }
    }
}

/// Position of a proposal among those of its block, 0 to [`N_SLOTS`] − 1: what an action says about its origin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Slot(u8);

impl Slot {
    /// Returns the slot of a kind with a partner.
    ///
    /// # Panics
    /// If the kind has none.
    pub fn paired(kind: Kind, partner: BlockIdx) -> Self {
        let at = Kind::PAIRED.iter().position(|&paired| paired == kind).expect("a kind with a partner");
        Self((at * N + partner.get()) as u8)
    }

    /// Returns the slot of a kind without a partner.
    ///
    /// # Panics
    /// If the kind has one.
    pub fn alone(kind: Kind) -> Self {
        let at = Kind::ALONE.iter().position(|&alone| alone == kind).expect("a kind without a partner");
        Self((Kind::PAIRED.len() * N + at) as u8)
    }

    /// Returns the slot with this index; `None` if there is none.
    pub fn from_index(index: u8) -> Option<Self> {
        (usize::from(index) < N_SLOTS).then_some(Self(index))
    }

    /// Returns the index.
    pub fn index(self) -> u8 {
        self.0
    }

    /// Returns the kind.
    pub fn kind(self) -> Kind {
        let at = usize::from(self.0);
        if at < Kind::PAIRED.len() * N { Kind::PAIRED[at / N] } else { Kind::ALONE[at - Kind::PAIRED.len() * N] }
    }

    /// Returns the partner, 0 to 15; `None` if the kind has none.
    pub fn partner(self) -> Option<usize> {
        let at = usize::from(self.0);
        (at < Kind::PAIRED.len() * N).then_some(at % N)
    }
}

/// One proposal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Proposal {
    /// Its place.
    pub slot: Slot,
    /// The mean of the move.
    pub movement: Move,
}

impl Proposal {
    /// Returns the standard deviation of the move, the same for all six entries.
    pub fn noise(&self) -> f32 {
        NOISE[0] + NOISE[1] * self.movement.iter().fold(0.0_f32, |most, x| most.max(x.abs()))
    }
}

/// The proposals of one scene, and what the choice among them depends on.
#[derive(Clone, Debug, PartialEq)]
pub struct Proposals {
    /// By block, then by slot.
    entries: Vec<Proposal>,
    /// The last entry of each block, exclusive.
    ends: [u16; N],
    /// `[receivers, senders]`
    relations: Vec<[f32; N_RELATION]>,
}

impl Proposals {
    /// Proposes moves for all blocks of a scene.
    pub fn new(observation: &Observation<'_>) -> Self {
        let view = View::new(observation.scene, observation.blueprint);
        let mut proposals =
            Self { entries: Vec::with_capacity(4 * N), ends: [0; N], relations: vec![[0.0; N_RELATION]; N * N] };
        let mut detaches = Vec::with_capacity(N);
        for i in BlockIdx::all() {
            detaches.clear();
            let around = OnceCell::new();
            let mut push = |slot, movement| proposals.entries.push(Proposal { slot, movement });
            for j in BlockIdx::all().filter(|&j| j != i) {
                let pair = view.pair(i, j, &around);
                pair.join.into_iter().for_each(|join| push(Slot::paired(Kind::Join, j), join));
                detaches.extend(pair.detach.map(|detach| (Slot::paired(Kind::Detach, j), detach)));
                proposals.relations[i.get() * N + j.get()] = pair.relation;
            }
            detaches.iter().for_each(|&(slot, detach)| push(slot, detach));
            push(Slot::alone(Kind::Hold), view.hold(i));
            proposals.ends[i.get()] = proposals.entries.len() as u16;
        }
        proposals
    }

    /// Returns the proposals of a block, by slot; never empty.
    pub fn of(&self, block: usize) -> &[Proposal] {
        &self.entries[self.range(block)]
    }

    /// Returns the proposal of a block in a slot; `None` if there is none in this scene.
    pub fn get(&self, block: usize, slot: Slot) -> Option<&Proposal> {
        let own = self.of(block);
        own.binary_search_by_key(&slot, |proposal| proposal.slot).ok().map(|at| &own[at])
    }

    /// Returns what block `i` is to block `j`, zeros if they are the same:
    ///
    /// | index | meaning | unit |
    /// |---|---|---|
    /// | 0 | to be connected, and in different pieces | 0 or 1 |
    /// | 1 | in one piece | 0 or 1 |
    /// | 2 | connected, correctly or not | 0 or 1 |
    /// | 3 | a gripper holds j | 0 or 1 |
    /// | 4 | if to be connected, and not correctly connected: exp(−n / 2), with the n steps to i's place | 0 to 1 |
    /// | 5 | the same with exp(−3 d), with the larger of the lateral distance and the turn, in steps | 0 to 1 |
    /// | 6 | to be connected, in one piece, and not connected | 0 or 1 |
    /// | 7 | connected, but not as the blueprint wants it | 0 or 1 |
    pub fn relation(&self, i: usize, j: usize) -> &[f32; N_RELATION] {
        &self.relations[i * N + j]
    }

    fn range(&self, block: usize) -> Range<usize> {
        let start = if block == 0 { 0 } else { self.ends[block - 1] };
        start.into()..self.ends[block].into()
    }
}

/// A scene with everything that proposals need of it.
struct View<'a> {
    blueprint: &'a Blueprint,
    frames: [Frame; N],
    pieces: [usize; N],
    /// Blocks with the same value move together: pieces, and what is wrongly connected to them.
    bodies: [usize; N],
    /// Largest distance from a block's center to the center of another of its piece, m.
    radii: [f32; N],
    /// The shape of each piece, at the index of its name.
    shapes: [Shape; N],
    connections: [[Connection; N]; N],
    held: [bool; N],
    /// Number of blocks of each piece, at the index of its name.
    sizes: [u8; N],
    solids: [Solid; N],
    /// Whether two blocks can move at once.
    has_two_grippers: bool,
}

#[derive(Clone, Copy, PartialEq)]
enum Connection {
    None,
    Right,
    Wrong,
}

/// What is around a block.
struct Surroundings {
    /// The blocks of all other pieces.
    obstacles: Vec<Solid>,
    /// Whether it touches one of them.
    is_touching: bool,
}

/// The proposals of an ordered pair.
struct Pair {
    join: Option<Move>,
    detach: Option<Move>,
    relation: [f32; N_RELATION],
}

impl<'a> View<'a> {
    fn new(scene: &Scene, blueprint: &'a Blueprint) -> Self {
        let frames = scene.blocks.each_ref().map(Frame::new);
        let pieces = scene.pieces(blueprint);
        let mut connections = [[Connection::None; N]; N];
        for joint in &scene.joints {
            let found = if joint.is_right(blueprint) { Connection::Right } else { Connection::Wrong };
            connections[joint.a.get()][joint.b.get()] = found;
            connections[joint.b.get()][joint.a.get()] = found;
        }
        let mut cells: [Vec<Cell>; N] = Default::default();
        for placement in blueprint.placements() {
            cells[pieces[placement.block.get()]].extend(placement.filled_cells(Inventory::standard()));
        }
        let radius = |i: usize| {
            let same = (0..N).filter(|&k| pieces[k] == pieces[i]);
            same.map(|k| (frames[k].position - frames[i].position).norm()).fold(0.0, f32::max)
        };
        let mut held = [false; N];
        scene.grippers.iter().flatten().filter_map(|gripper| gripper.held).for_each(|block| held[block.get()] = true);
        let mut sizes = [0; N];
        pieces.iter().for_each(|&piece| sizes[piece] += 1);
        let solid = |i: usize| Solid::new(BlockIdx::try_from(i as u8).expect("below 16"), frames[i]);
        Self {
            blueprint,
            radii: std::array::from_fn(radius),
            solids: std::array::from_fn(solid),
            frames,
            pieces,
            bodies: scene.bodies(),
            shapes: cells.map(Shape::new),
            connections,
            held,
            sizes,
            has_two_grippers: scene.grippers.iter().all(Option::is_some),
        }
    }

    fn size(&self, block: BlockIdx) -> u8 {
        self.sizes[self.pieces[block.get()]]
    }

    /// Returns i's part of the way if both come. It falls with the square of the number of blocks that move with i:
    /// large pieces break when they move or turn fast.
    fn share(&self, i: BlockIdx, j: BlockIdx) -> f32 {
        let [own, other] = [i, j].map(|block| f32::from(self.size(block)).powi(2));
        other / (own + other)
    }

    fn hold(&self, i: BlockIdx) -> Move {
        self.rise(i, HOLD_M - self.frames[i.get()].position.z)
    }

    /// Returns a move that holds i until j has come.
    fn wait(&self, i: BlockIdx, j: BlockIdx) -> Move {
        let own = &self.frames[i.get()];
        let place = self.blueprint.relative(i, j).map(|place| own.position + own.axes * place.position_m());
        let lowest = place.map_or(own.position.z, |place| place.z.min(own.position.z));
        self.rise(i, HOLD_M - lowest)
    }

    /// Returns a move straight up by at most `height_m` and one step.
    fn rise(&self, i: BlockIdx, height_m: f32) -> Move {
        let up = self.frames[i.get()].localize(&Vector3::z()) * (height_m / STEP_M).clamp(0.0, 1.0);
        [up.x, up.y, up.z, 0.0, 0.0, 0.0]
    }

    fn pair(&self, i: BlockIdx, j: BlockIdx, around: &OnceCell<Surroundings>) -> Pair {
        let connection = self.connections[i.get()][j.get()];
        let (is_none, is_wrong) = (connection == Connection::None, connection == Connection::Wrong);
        let is_joined = self.pieces[i.get()] == self.pieces[j.get()];
        let link = self.blueprint.link(i, j);
        let is_linked = link.is_some();
        let bits = [
            is_linked && !is_joined,
            is_joined,
            !is_none,
            self.held[j.get()],
            false,
            false,
            is_linked && is_joined && is_none,
            is_wrong,
        ];
        let mut relation = bits.map(|bit| f32::from(u8::from(bit)));
        let mut join = None;
        let open = link.filter(|_| connection != Connection::Right);
        if let Some((link, way)) = open.zip(self.way(i, j)) {
            let normal = self.normal(i, j, link, is_joined);
            let (lateral_m, turn_rad) = way.off_axis(&normal);
            relation[4] = (-0.5 * way.n_steps()).exp();
            relation[5] = (-3.0 * (lateral_m / STEP_M).max(turn_rad / STEP_RAD)).exp();
            // Toward a block that moves along, both would move, and nothing would change.
            if is_none && (is_joined || self.bodies[i.get()] != self.bodies[j.get()]) {
                let both_come = relation[5] > BOTH_COME;
                join = Some(self.join([i, j], around, way, &normal, both_come));
            }
        }
        Pair { join, detach: is_wrong.then(|| self.detach(i, j)), relation }
    }

    /// Returns i's part in joining j.
    fn join(
        &self,
        [i, j]: [BlockIdx; 2],
        around: &OnceCell<Surroundings>,
        mut way: Way,
        normal: &Vector3<f32>,
        is_aligned: bool,
    ) -> Move {
        let (own, other) = (self.size(i), self.size(j));
        let both_come = self.has_two_grippers && (is_aligned || own == other);
        if self.has_two_grippers && own > other && !both_come {
            return self.wait(i, j);
        }
        let around = around.get_or_init(|| self.surroundings(i));
        let off = self.stand_off([i, j], around, &way, normal);
        way.shift += normal * off;
        if self.pieces[i.get()] != self.pieces[j.get()] {
            // From where it is aligned, the pieces part freely.
            if off >= 0.0 {
                way.shift = self.detour(i, around, &way, normal);
            }
            if own <= other {
                way.shift += self.lift(i, &way);
            }
        }
        if both_come { way.part(self.share(i, j)).to_move() } else { way.to_move() }
    }

    fn surroundings(&self, i: BlockIdx) -> Surroundings {
        let own = &self.solids[i.get()];
        let others = (0..N).filter(|&k| self.pieces[k] != self.pieces[i.get()]);
        let obstacles: Vec<Solid> = others.map(|k| self.solids[k]).collect();
        let at = &own.frame.position;
        let mut near = obstacles.iter().filter(|obstacle| obstacle.may_meet(own, TOUCH_M, at, at));
        let is_touching = near.any(|obstacle| own.gap(obstacle) < TOUCH_M);
        Surroundings { obstacles, is_touching }
    }

    /// Returns how far off its place a block stays for now, along `normal`, m; below 0 once it is aligned.
    fn stand_off(&self, [i, j]: [BlockIdx; 2], around: &Surroundings, way: &Way, normal: &Vector3<f32>) -> f32 {
        let (lateral_m, turn_rad) = way.off_axis(normal);
        let wide = self.radii[i.get()].min(self.radii[j.get()]);
        let funnel = |left: f32| {
            let off = FUNNEL_SLOPE * (left * lateral_m - ALIGNED_M).max(0.0)
                + (FUNNEL_PER_RAD + wide) * (left * turn_rad - ALIGNED_RAD).max(0.0);
            off.min(FUNNEL_M + wide)
        };
        let now = funnel(1.0);
        if now == 0.0 {
            return -PRESS_M;
        }
        let left = 1.0 - 1.0 / way.n_steps().max(1.0);
        let off = funnel(left).max(now.min(NEAR_M + NEAR_PER_RADIUS * wide));
        let turns_here = around.is_touching && self.size(i) <= self.size(j);
        if turns_here { self.room_to_turn(i, around, way, normal, off).unwrap_or(off) } else { off }
    }

    /// Returns the least distance from its place, from `least` on, toward which a block can go and turn for a step
    /// without touching anything.
    fn room_to_turn(
        &self,
        i: BlockIdx,
        around: &Surroundings,
        way: &Way,
        normal: &Vector3<f32>,
        least: f32,
    ) -> Option<f32> {
        let own = &self.frames[i.get()];
        let is_free = |off: &f32| {
            let way = Way { shift: way.shift + normal * *off, turn: way.turn };
            let step = 1.0 / way.n_steps().max(1.0);
            [0.5 * step, step].into_iter().all(|part| {
                let there = Solid::new(i, way.part(part).moved(own));
                around.obstacles.iter().all(|obstacle| there.gap(obstacle) > -SLACK_M)
            })
        };
        let [step, most] = BACK_OFF_M;
        (0..).map(|n| least + step * n as f32).take_while(|&off| off < most).find(is_free)
    }

    /// Returns what must be added to a way so that its next step does not end in the ground.
    fn lift(&self, i: BlockIdx, way: &Way) -> Vector3<f32> {
        let (own, n_steps) = (&self.frames[i.get()], way.n_steps().max(1.0));
        let lowest = Solid::new(i, way.part(1.0 / n_steps).moved(own)).lowest_m();
        own.localize(&Vector3::z()) * ((-lowest).max(0.0) * n_steps)
    }

    /// Returns the first straight part of a way that leads around the obstacles, in the block's frame, m.
    fn detour(&self, i: BlockIdx, around: &Surroundings, way: &Way, normal: &Vector3<f32>) -> Vector3<f32> {
        let own = &self.frames[i.get()];
        let to = own.position + own.axes * way.shift;
        let mover = Solid::new(i, way.moved(own));
        let stop = next_stop(&mover, &own.position, &to, &(own.axes * normal), &around.obstacles);
        own.localize(&(stop - own.position))
    }

    /// Returns the exact way of `i` to its place relative to a fixed `j`; `None` if the blueprint lacks one of them.
    fn way(&self, i: BlockIdx, j: BlockIdx) -> Option<Way> {
        let wanted = self.blueprint.relative(i, j)?;
        let (own, other) = (&self.frames[i.get()], &self.frames[j.get()]);
        let offset = own.localize(&(other.position - own.position));
        let current = own.axes.tr_mul(&other.axes);
        // With j at (offset, C) in i's frame, the place (m, T) of i satisfies offset = m + T · wanted and C = T · D.
        let turn = current * matrix(wanted.rotation.matrix()).transpose();
        Some(Way { shift: offset - turn * wanted.position_m(), turn: rotation_vector(&turn) })
    }

    /// Returns the unit vector in i's frame along which i comes to j from outside.
    fn normal(&self, i: BlockIdx, j: BlockIdx, link: &Link, is_joined: bool) -> Vector3<f32> {
        let of_j = match self.blueprint.placement(j) {
            Some(place) if !is_joined => {
                let [a, b] = [i, j].map(|block| &self.shapes[self.pieces[block.get()]]);
                opening(a, b).map(|direction| place.rotation.inverse().apply(direction))
            }
            _ => None,
        };
        let of_j = of_j.unwrap_or_else(|| contact_normal(j, link));
        let current = self.frames[i.get()].axes.tr_mul(&self.frames[j.get()].axes);
        current * Vector3::from(of_j.map(|x| x as f32)).normalize()
    }

    /// Returns a move that pulls, lifts, bends, and twists.
    fn detach(&self, i: BlockIdx, j: BlockIdx) -> Move {
        let (own, other) = (&self.frames[i.get()], &self.frames[j.get()]);
        let away = (own.position - other.position).try_normalize(1e-6).unwrap_or_else(Vector3::z);
        let hinge = away.cross(&Vector3::z()).try_normalize(0.1).unwrap_or_else(Vector3::x);
        let share = 2.0 * self.share(i, j);
        let linear = own.localize(&(away * PULL + Vector3::z() * PULL_UP)) * share.min(1.0);
        let angular = own.localize(&(hinge + away));
        let angular = angular * (share.min(1.0) / angular.amax().max(1.0));
        [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
    }
}

/// A rigid motion of a block, in its own frame.
#[derive(Clone, Copy)]
struct Way {
    /// m
    shift: Vector3<f32>,
    /// Axis times angle, rad.
    turn: Vector3<f32>,
}

impl Way {
    /// Returns this part of the motion.
    fn part(self, share: f32) -> Self {
        Self { shift: self.shift * share, turn: self.turn * share }
    }

    /// Returns where the motion leads.
    fn moved(&self, own: &Frame) -> Frame {
        let axes = own.axes * Rotation3::new(self.turn).matrix();
        Frame { position: own.position + own.axes * self.shift, axes }
    }

    /// Returns the number of steps that the motion takes at full speed.
    fn n_steps(&self) -> f32 {
        (self.shift.amax() / STEP_M).max(self.turn.amax() / STEP_RAD)
    }

    /// Returns the distance from the line through the place along `normal`, m, and the angle to turn, rad.
    fn off_axis(&self, normal: &Vector3<f32>) -> (f32, f32) {
        ((self.shift - normal * normal.dot(&self.shift)).norm(), self.turn.norm())
    }

    /// Returns the velocities of one step.
    fn to_move(self) -> Move {
        let n_steps = self.n_steps().max(1.0);
        let (linear, angular) = (self.shift / (STEP_M * n_steps), self.turn / (STEP_RAD * n_steps));
        [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
    }
}

/// Returns the outward normal, in j's frame, of j's face at a connection.
fn contact_normal(j: BlockIdx, link: &Link) -> [i32; 3] {
    let inventory = Inventory::standard();
    let other = if link.a == j { link.b } else { link.a };
    let relative = if link.a == j { link.relative } else { link.relative.inverse() };
    let own = inventory.cells(j).map(i32::from);
    let other = relative.rotation.apply(inventory.cells(other).map(i32::from)).map(i32::abs);
    // The boxes touch where their centers are half of both sizes apart, in half units: the sum of their cells.
    let touches = |k: usize| relative.offset_half_units[k].abs() == own[k] + other[k];
    std::array::from_fn(|k| if touches(k) { relative.offset_half_units[k].signum() } else { 0 })
}

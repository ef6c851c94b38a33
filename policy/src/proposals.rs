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
//!  hold: rise to half a meter, level
//! ```
//!
//! | kind | of | the move of i | proposed if |
//! |---|---|---|---|
//! | [`Join`](Kind::Join) | each j | its part of the way to its place relative to j; through the funnel until it is aligned | the blueprint connects the two, nothing does yet, and no wrong connection makes them move together |
//! | [`Detach`](Kind::Detach) | each j | away from j, a little up, and turning | the two are connected, but not as the blueprint wants it |
//! | [`Hold`](Kind::Hold) | i | up to half a meter above the ground, no further if it is higher; its piece is leveled | always |
//!
//! **The funnel.** On the way to its place, i stays off j in the direction in which their pieces part most freely, if
//! possible without passing beside other blocks, whose magnets would catch it (`openings.rs`). If i and j belong to one
//! piece already, the direction is the normal of the connection. The farther i will be from the axis after this step, and
//! the more it will have to turn, the farther off it stays. Once i is aligned, the funnel ends, and the move goes a little
//! too far: magnets snap before the blocks touch, and they do so in this step instead of the next.
//!
//! **Turning.** A block that touches another and has to turn first backs off as far as it needs for that. Otherwise, it
//! would press against both walls of a corner forever.
//!
//! **Going back.** A block that moved by less than three quarters of what its gripper wanted in the last step is caught,
//! or pushes another held block: it goes back by 30 cm and a little up. The next step comes from another place. Without
//! that, greedy actions would push forever.
//!
//! **The detour.** If blocks of other pieces are between i and that point, i goes around them (`detour.rs`): straight
//! ways through a structure were what broke most of its connections.
//!
//! **Parts of the way.** Of two pieces, the larger one waits until the smaller one is aligned, so high that there is room
//! below the place where the other will be. Then both come, and the larger one goes a smaller part of the way. Pieces of
//! one size go half of the way from the start. Where there is only one gripper, its block goes all the way. If nothing
//! moved in the last step, the larger piece rises by another step, because the way of the other may need more room below.
//! If nobody held the other, it goes itself, the slower the larger it is.
//!
//! **Leveling.** A piece that is held, or waits, and reaches 40 cm and farther turns about the held block until it lies
//! level, by 10 cm a step at its end: what hangs askew is higher up than need be, and breaks when it is let go.
//!
//! **Coming.** A piece that reaches 70 cm and farther also comes while it waits, by up to 20 cm a step, without going down:
//! the ways to its ends are long. It neither turns nor comes once the other block is two steps away.
//!
//! All moves are velocities as fractions of the world's limits, as in [`Action`](proto::Action). A move that would take
//! more than one step is scaled down, so that shift and turn arrive together.

mod detour;
mod moves;
mod openings;
mod solid;
mod way;

use blueprints::{BlockIdx, Blueprint, Inventory, Link, N_BLOCKS as N, RelativePlacement};
use nalgebra::Vector3;
use proto::{Move, Observation, Scene};

use self::moves::{Joining, Layout};
use self::openings::{Cell, Shape, opening};
use self::way::{STEP_M, STEP_RAD, Way};
use crate::geometry::{matrix, rotation_vector};

/// Number of slots of a block: one for each kind with a partner and each partner, and one to hold.
pub const N_SLOTS: usize = Kind::PAIRED.len() * N + 1;

/// Number of entries of a [relation](Proposals::relation).
pub const N_RELATION: usize = 8;

/// Standard deviation of a move, as a fraction of the limits: constant part, and factor of its largest entry. The sum
/// at full speed is 9 mm; magnets snap within 3 cm.
const NOISE: [f32; 2] = [0.01, 0.02];

/// Entry 5 of a relation from which on both pieces come.
const BOTH_COME: f32 = 0.5;

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
    /// All kinds, in the order of their slots.
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
    /// The slot to hold.
    pub const HOLD: Self = Self((N_SLOTS - 1) as u8);

    /// Returns the slot of a kind with a partner.
    ///
    /// # Panics
    /// If the kind has none.
    pub fn paired(kind: Kind, partner: BlockIdx) -> Self {
        let at = Kind::PAIRED.iter().position(|&paired| paired == kind).expect("a kind with a partner");
        Self((at * N + partner.get()) as u8)
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
        Kind::ALL[usize::from(self.0) / N]
    }

    /// Returns the partner; `None` if the kind has none.
    pub fn partner(self) -> Option<BlockIdx> {
        if self == Self::HOLD { None } else { BlockIdx::try_from(self.0 % N as u8).ok() }
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
///
/// Moves are computed when they are asked for: a choice needs only the relations, and few of the moves are made.
#[derive(Clone, Debug, PartialEq)]
pub struct Proposals {
    layout: Layout,
    /// By block, then by slot.
    slots: Vec<Slot>,
    /// The last slot of each block, exclusive.
    ends: [u16; N],
    /// By block, then by partner: one for each join.
    joinings: Vec<(BlockIdx, BlockIdx, Joining)>,
    /// `[receivers, senders]`
    relations: Vec<[f32; N_RELATION]>,
}

impl Proposals {
    /// Finds what is proposed for all blocks of a scene.
    pub fn new(observation: &Observation<'_>) -> Self {
        let view = View::new(observation.scene, observation.blueprint);
        let mut slots = Vec::with_capacity(4 * N);
        let mut ends = [0; N];
        let mut joinings = Vec::with_capacity(2 * N);
        let mut relations = vec![[0.0; N_RELATION]; N * N];
        for i in BlockIdx::all() {
            let others = || BlockIdx::all().filter(|&j| j != i);
            for j in others() {
                let (relation, joining) = view.pair(i, j);
                relations[i.get() * N + j.get()] = relation;
                if let Some(joining) = joining {
                    slots.push(Slot::paired(Kind::Join, j));
                    joinings.push((i, j, joining));
                }
            }
            let wrong = others().filter(|&j| view.connections[i.get()][j.get()] == Connection::Wrong);
            slots.extend(wrong.map(|j| Slot::paired(Kind::Detach, j)));
            slots.push(Slot::HOLD);
            ends[i.get()] = slots.len() as u16;
        }
        Self { layout: view.layout, slots, ends, joinings, relations }
    }

    /// Returns the slots of a block that have a proposal, in order; never empty.
    pub fn slots(&self, block: BlockIdx) -> &[Slot] {
        let start = if block.get() == 0 { 0 } else { self.ends[block.get() - 1] };
        &self.slots[usize::from(start)..usize::from(self.ends[block.get()])]
    }

    /// Returns the proposal of a block in a slot; `None` if there is none in this scene.
    pub fn get(&self, block: BlockIdx, slot: Slot) -> Option<Proposal> {
        self.slots(block).binary_search(&slot).ok()?;
        let movement = match (slot.kind(), slot.partner()) {
            (Kind::Join, Some(partner)) => {
                let key = |joining: &(BlockIdx, BlockIdx, Joining)| (joining.0, joining.1);
                let at = self.joinings.binary_search_by_key(&(block, partner), key).ok()?;
                self.layout.join([block, partner], &self.joinings[at].2)
            }
            (Kind::Detach, Some(partner)) => self.layout.detach(block, partner),
            _ => self.layout.hold(block),
        };
        Some(Proposal { slot, movement })
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
    pub fn relation(&self, i: BlockIdx, j: BlockIdx) -> &[f32; N_RELATION] {
        &self.relations[i.get() * N + j.get()]
    }
}

/// A scene with everything that relations need of it.
struct View<'a> {
    blueprint: &'a Blueprint,
    layout: Layout,
    /// Blocks with the same value move together: pieces, and what is wrongly connected to them.
    bodies: [usize; N],
    /// The shape of each piece, at the index of its name.
    shapes: [Shape; N],
    links: [[Option<&'a Link>; N]; N],
    connections: [[Connection; N]; N],
    held: [bool; N],
}

#[derive(Clone, Copy, PartialEq)]
enum Connection {
    None,
    Right,
    Wrong,
}

impl<'a> View<'a> {
    fn new(scene: &Scene, blueprint: &'a Blueprint) -> Self {
        let pieces = scene.pieces(blueprint);
        let mut links = [[None; N]; N];
        for link in blueprint.links() {
            (links[link.a.get()][link.b.get()], links[link.b.get()][link.a.get()]) = (Some(link), Some(link));
        }
        let mut connections = [[Connection::None; N]; N];
        for joint in &scene.joints {
            let found = if joint.is_right(blueprint) { Connection::Right } else { Connection::Wrong };
            connections[joint.a.get()][joint.b.get()] = found;
            connections[joint.b.get()][joint.a.get()] = found;
        }
        let mut cells: [Vec<Cell>; N] = Default::default();
        for placement in blueprint.placements() {
            cells[pieces[placement.block.get()]].extend(placement.filled_cells());
        }
        let mut held = [false; N];
        scene.grippers.iter().flatten().filter_map(|gripper| gripper.held).for_each(|block| held[block.get()] = true);
        let layout = Layout::new(scene, pieces);
        let shapes = cells.map(Shape::new);
        Self { blueprint, layout, bodies: scene.bodies(), shapes, links, connections, held }
    }

    /// Returns what i is to j, and how to join it if that is proposed.
    fn pair(&self, i: BlockIdx, j: BlockIdx) -> ([f32; N_RELATION], Option<Joining>) {
        let connection = self.connections[i.get()][j.get()];
        let (is_none, is_wrong) = (connection == Connection::None, connection == Connection::Wrong);
        let is_joined = self.layout.pieces[i.get()] == self.layout.pieces[j.get()];
        let link = self.links[i.get()][j.get()];
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
        let Some(link) = link.filter(|_| connection != Connection::Right) else { return (relation, None) };
        let wanted = if link.a == i { link.relative } else { link.relative.inverse() };
        let way = self.way(i, j, &wanted);
        let place_m = wanted.position_m();
        let normal = self.normal(i, j, &wanted, is_joined);
        let (lateral_m, turn_rad) = way.off_axis(&normal);
        relation[4] = (-0.5 * way.n_steps()).exp();
        relation[5] = (-3.0 * (lateral_m / STEP_M).max(turn_rad / STEP_RAD)).exp();
        // Toward a block that moves along, both would move, and nothing would change.
        let is_open = is_none && (is_joined || self.bodies[i.get()] != self.bodies[j.get()]);
        (relation, is_open.then_some(Joining { way, normal, place_m, is_aligned: relation[5] > BOTH_COME }))
    }

    /// Returns the exact way of `i` to its place relative to a fixed `j`, which is `wanted` relative to `i`.
    fn way(&self, i: BlockIdx, j: BlockIdx, wanted: &RelativePlacement) -> Way {
        let [own, other] = [i, j].map(|block| &self.layout.frames[block.get()]);
        let offset = own.localize(&(other.position - own.position));
        let current = own.axes.tr_mul(&other.axes);
        // With j at (offset, C) in i's frame, the place (m, T) of i satisfies offset = m + T · wanted and C = T · D.
        let turn = current * matrix(wanted.rotation.matrix()).transpose();
        Way { shift: offset - turn * wanted.position_m(), turn: rotation_vector(&turn) }
    }

    /// Returns the unit vector in i's frame along which i comes to j from outside.
    fn normal(&self, i: BlockIdx, j: BlockIdx, wanted: &RelativePlacement, is_joined: bool) -> Vector3<f32> {
        let of_j = match self.blueprint.placement(j) {
            Some(place) if !is_joined => {
                let [a, b] = [i, j].map(|block| &self.shapes[self.layout.pieces[block.get()]]);
                opening(a, b).map(|direction| place.rotation.inverse().apply(direction))
            }
            _ => None,
        };
        let of_j = of_j.unwrap_or_else(|| contact_normal(i, j, wanted));
        let [own, other] = [i, j].map(|block| &self.layout.frames[block.get()]);
        own.axes.tr_mul(&other.axes) * Vector3::from(of_j.map(|x| x as f32)).normalize()
    }
}

/// Returns the outward normal, in j's frame, of j's face at its connection with i, relative to which j is `wanted`.
fn contact_normal(i: BlockIdx, j: BlockIdx, wanted: &RelativePlacement) -> [i32; 3] {
    let inventory = Inventory::standard();
    let relative = wanted.inverse();
    let own = inventory.cells(j).map(i32::from);
    let other = relative.rotation.apply(inventory.cells(i).map(i32::from)).map(i32::abs);
    // The boxes touch where their centers are half of both sizes apart, in half units: the sum of their cells.
    let touches = |k: usize| relative.offset_half_units[k].abs() == own[k] + other[k];
    std::array::from_fn(|k| if touches(k) { relative.offset_half_units[k].signum() } else { 0 })
}

//! The moves of proposals.

use blueprints::{BlockIdx, N_BLOCKS as N};
use nalgebra::Vector3;
use proto::{Gripper, Move, Scene};

use super::detour::next_stop;
use super::solid::Solid;
use super::way::{STEP_M, Way};
use crate::geometry::Frame;

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

/// Commanded speed from which a block can be blocked, m/s, with this radius for its turn, m.
const PUSH_MPS: f32 = 0.1;
const PUSH_RADIUS_M: f32 = 0.05;
/// Part of the commanded speed below which a block is blocked. Two held blocks that push each other move at 0.4 to 0.7.
const BLOCKED: f32 = 0.75;
/// How far a blocked block goes back, m, and by how much of that it rises.
const RETREAT_M: f32 = 0.3;
const RETREAT_UP: f32 = 0.5;

/// Height to which a held block, or the place of a block that is to come to it, rises, m: room for other blocks below.
const HOLD_M: f32 = 0.5;
/// Reach from which a piece is leveled, m, and how far its end moves for that in a step, m.
const LEVEL_FROM_M: f32 = 0.4;
const LEVEL_M: f32 = 0.1;
/// Reach from which a piece that waits comes, m, and how far it comes in a step, m.
const COME_FROM_M: f32 = 0.7;
const COME_M: f32 = 0.2;
/// Steps until the other piece is there, from which on this one only rises.
const STILL_STEPS: f32 = 2.0;
/// Speed below which a block is idle, m/s, with this radius for its turn, m.
const IDLE_MPS: f32 = 0.15;
const IDLE_RADIUS_M: f32 = 0.3;
/// Number of blocks that one gripper can bring at full speed.
const N_FAST: f32 = 2.0;
/// Pull and lift of a detachment, as fractions of the speed limit.
const PULL: f32 = 0.4;
const PULL_UP: f32 = 0.06;

/// Where the blocks are, and what moves together.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Layout {
    pub(super) frames: [Frame; N],
    /// Blocks with the same value are correctly connected, directly or through others.
    pub(super) pieces: [usize; N],
    /// Number of blocks of each piece, at the index of its name.
    sizes: [u8; N],
    /// From a block's center to the farthest center of its piece, in the world, m.
    reaches: [Vector3<f32>; N],
    /// Where blocks go back to that a gripper pushed in vain: vectors in the world, m.
    retreats: [Option<Vector3<f32>>; N],
    /// Whether a gripper held a block of each piece in the last step, at the index of its name.
    held: [bool; N],
    /// Whether both grippers held blocks in the last step that stayed where they were, and were meant to.
    is_idle: bool,
    /// Whether two blocks can move at once.
    has_two_grippers: bool,
}

/// A connection that i is to make with j.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Joining {
    /// To the place of i.
    pub(super) way: Way,
    /// Unit vector in i's frame along which i comes to j from outside.
    pub(super) normal: Vector3<f32>,
    /// The place of j in i's frame, m.
    pub(super) place_m: Vector3<f32>,
    /// Whether i is so near the axis that both come.
    pub(super) is_aligned: bool,
}

/// What is around a block.
struct Surroundings {
    /// The blocks of all other pieces.
    obstacles: Vec<Solid>,
    /// Whether it touches one of them.
    is_touching: bool,
}

impl Layout {
    pub(super) fn new(scene: &Scene, pieces: [usize; N]) -> Self {
        let frames = scene.blocks.each_ref().map(Frame::new);
        let reach = |i: usize| {
            let same = (0..N).filter(|&k| pieces[k] == pieces[i]);
            let ways = same.map(|k| frames[k].position - frames[i].position);
            ways.max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared())).unwrap_or_default()
        };
        let mut sizes = [0; N];
        pieces.iter().for_each(|&piece| sizes[piece] += 1);
        let has_two_grippers = scene.grippers.iter().all(Option::is_some);
        let mut held = [false; N];
        let grippers = || scene.grippers.iter().flatten();
        grippers().filter_map(|gripper| gripper.held).for_each(|block| held[pieces[block.get()]] = true);
        let is_still = |gripper: &Gripper| {
            let wanted_mps = wanted_mps(gripper, IDLE_RADIUS_M);
            gripper.held.is_some_and(|block| wanted_mps < IDLE_MPS && scene.speeds_mps[block.get()] < IDLE_MPS)
        };
        let is_idle = has_two_grippers && grippers().all(is_still);
        let (reaches, retreats) = (std::array::from_fn(reach), retreats(scene));
        Self { frames, pieces, sizes, reaches, retreats, held, is_idle, has_two_grippers }
    }

    /// Returns i's part in joining j.
    pub(super) fn join(&self, [i, j]: [BlockIdx; 2], joining: &Joining) -> Move {
        let Joining { mut way, normal, place_m, is_aligned } = *joining;
        let (own, other) = (self.size(i), self.size(j));
        let both_come = self.has_two_grippers && (is_aligned || own == other);
        let waits = self.has_two_grippers && own > other && !both_come;
        // If nobody brings what both grippers wait for, it is fetched.
        let fetches = waits && self.is_idle && !self.held[self.pieces[j.get()]];
        if waits && !fetches {
            return self.wait([i, j], &place_m, way.n_steps());
        }
        let is_apart = self.pieces[i.get()] != self.pieces[j.get()];
        if let Some(retreat) = self.retreats[i.get()].filter(|_| is_apart && own <= other) {
            return self.step(i, &retreat, &Vector3::zeros());
        }
        let around = self.surroundings(i);
        let off = self.stand_off([i, j], &around, &way, &normal);
        way.shift += normal * off;
        if is_apart {
            // From where it is aligned, the pieces part freely.
            if off >= 0.0 {
                way.shift = self.detour(i, &around, &way, &normal);
            }
            if own <= other || fetches {
                way.shift += self.lift(i, &way);
            }
        }
        let share = if both_come { self.share(i, j) } else { 1.0 };
        let speed = if fetches { (N_FAST / f32::from(own)).min(1.0) } else { 1.0 };
        way.part(share).to_move().map(|x| speed * x)
    }

    /// Returns a move of i away from j that pulls, lifts, bends, and twists.
    pub(super) fn detach(&self, i: BlockIdx, j: BlockIdx) -> Move {
        let (own, other) = (&self.frames[i.get()], &self.frames[j.get()]);
        let away = (own.position - other.position).try_normalize(1e-6).unwrap_or_else(Vector3::z);
        let hinge = away.cross(&Vector3::z()).try_normalize(0.1).unwrap_or_else(Vector3::x);
        let share = 2.0 * self.share(i, j);
        let linear = own.localize(&(away * PULL + Vector3::z() * PULL_UP)) * share.min(1.0);
        let angular = own.localize(&(hinge + away));
        let angular = angular * (share.min(1.0) / angular.amax().max(1.0));
        [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
    }

    /// Returns a move of i up to half a meter that levels its piece.
    pub(super) fn hold(&self, i: BlockIdx) -> Move {
        self.step(i, &up(HOLD_M - self.frames[i.get()].position.z), &self.leveling(i))
    }

    /// Returns i's move while j is on its way to `place_m`, in i's frame, where it will be in `n_steps`. The piece rises
    /// and is leveled. If both grippers only waited, it rises by a whole step, because the way of j may need more room
    /// below. A long one also comes, but not down, because the ways to its ends are long.
    fn wait(&self, [i, j]: [BlockIdx; 2], place_m: &Vector3<f32>, n_steps: f32) -> Move {
        let own = &self.frames[i.get()];
        let place = own.position + own.axes * place_m;
        let rise = if self.is_idle { up(STEP_M) } else { up(HOLD_M - own.position.z.min(place.z)) };
        if n_steps <= STILL_STEPS {
            return self.step(i, &rise, &Vector3::zeros());
        }
        let mut to_j = self.frames[j.get()].position - place;
        to_j.z = 0.0;
        let is_long = self.reaches[i.get()].norm() >= COME_FROM_M;
        let come = if is_long { to_j.cap_magnitude(COME_M) } else { Vector3::zeros() };
        self.step(i, &(rise + come), &self.leveling(i))
    }

    /// Returns i's move by a shift, m, and a turn, rad, in the world: one step of them if they take more.
    fn step(&self, i: BlockIdx, shift: &Vector3<f32>, turn: &Vector3<f32>) -> Move {
        let own = &self.frames[i.get()];
        Way { shift: own.localize(shift), turn: own.localize(turn) }.to_move()
    }

    /// Returns the turn about i that brings the piece nearer to the horizontal, in the world, rad; zero for a short one.
    fn leveling(&self, i: BlockIdx) -> Vector3<f32> {
        let reach = &self.reaches[i.get()];
        let length = reach.norm();
        if length < LEVEL_FROM_M {
            return Vector3::zeros();
        }
        let (tilt, most) = ((reach.z / length).clamp(-1.0, 1.0).asin(), LEVEL_M / length);
        let axis = reach.cross(&Vector3::z()).try_normalize(1e-3).unwrap_or_else(Vector3::x);
        axis * -tilt.clamp(-most, most)
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

    fn surroundings(&self, i: BlockIdx) -> Surroundings {
        let solid = |block: BlockIdx| Solid::new(block, self.frames[block.get()]);
        let others = BlockIdx::all().filter(|k| self.pieces[k.get()] != self.pieces[i.get()]);
        let (own, obstacles): (Solid, Vec<Solid>) = (solid(i), others.map(solid).collect());
        let at = &own.frame.position;
        let mut near = obstacles.iter().filter(|obstacle| obstacle.may_meet(&own, TOUCH_M, at, at));
        let is_touching = near.any(|obstacle| own.gap(obstacle) < TOUCH_M);
        Surroundings { obstacles, is_touching }
    }

    /// Returns how far off its place a block stays for now, along `normal`, m; below 0 once it is aligned.
    fn stand_off(&self, [i, j]: [BlockIdx; 2], around: &Surroundings, way: &Way, normal: &Vector3<f32>) -> f32 {
        let (lateral_m, turn_rad) = way.off_axis(normal);
        let wide = self.reaches[i.get()].norm().min(self.reaches[j.get()].norm());
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
        let own = &self.frames[i.get()];
        let n_steps = way.n_steps().max(1.0);
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
}

/// Returns the way straight up, in the world: `height_m`, but at most one step, and none down.
fn up(height_m: f32) -> Vector3<f32> {
    Vector3::z() * height_m.clamp(0.0, STEP_M)
}

/// Returns the speed that a gripper wanted of points at this radius, at most, m/s.
fn wanted_mps(gripper: &Gripper, radius_m: f32) -> f32 {
    Vector3::from(gripper.linear_velocity).norm() + radius_m * Vector3::from(gripper.angular_velocity).norm()
}

/// Returns where blocks go back to that moved much more slowly in the last step than their grippers wanted.
fn retreats(scene: &Scene) -> [Option<Vector3<f32>>; N] {
    let mut retreats = [None; N];
    for gripper in scene.grippers.iter().flatten() {
        let Some(block) = gripper.held else { continue };
        let wanted_mps = wanted_mps(gripper, PUSH_RADIUS_M);
        if wanted_mps > PUSH_MPS && scene.speeds_mps[block.get()] < BLOCKED * wanted_mps {
            let back =
                Vector3::from(gripper.linear_velocity).try_normalize(1e-3).map_or_else(Vector3::zeros, |push| -push);
            retreats[block.get()] = (back + Vector3::z() * RETREAT_UP).try_normalize(1e-3).map(|way| way * RETREAT_M);
        }
    }
    retreats
}

//! Fetching: chooses the next pieces and brings them in.

use blueprints::assembly::{Approach, MIN_BUILD_MARGIN_U, Parts};
use blueprints::{BlockIdx, UNIT_M};
use nalgebra::{Isometry3, Translation3, Vector3};

use super::motion::{Limits, Load, Twist, gap};
use super::view::View;
use super::{Base, Command, Expert};
use crate::world::CONTROL_DT_S;

/// Maximum distance from the approach path's axis for a piece to come in all the way, m. A piece farther aside holds
/// back by `ASIDE_SLOPE` times the excess.
const MAX_ASIDE_M: f32 = 0.02;
const ASIDE_SLOPE: f32 = 2.0;
/// Maximum rotation from the target for a piece to come in all the way, rad. A piece turned further holds back by
/// `TURN_SLOPE_M` meters per radian of excess.
const MAX_TURN_RAD: f32 = 0.12;
const TURN_SLOPE_M: f32 = 0.2;
/// Maximum distance from the axis, m, and rotation from the target, rad, of a piece on its way in.
const WIDEST_M: f32 = 0.06;
const WIDEST_RAD: f32 = 0.5;
/// Distance from the target at which the fast part of the entry ends, m. Here the magnets have just caught.
const BRAKE_M: f32 = 0.022;
/// Speed of the fast part, m/s. At 2 m/s, half of the episodes of `10_000` ended in broken connections.
const ENTRY_SPEED_MPS: f32 = 1.6;
/// Speed of the rest, m/s. Once the magnets have snapped, the gripper drags the whole structure along.
const TOUCH_SPEED_MPS: f32 = 0.4;
/// Distance below which two carried pieces move apart, m.
const YIELD_M: f32 = 0.05;
/// Distance from the approach path within which a stray is in the way, m; more than the margin on the way to its start.
const STRAY_MARGIN_M: f32 = 0.025;
/// Horizontal speed at which a stray is thrown aside, m/s, and its rise per meter aside.
const FLING_SPEED_MPS: f32 = 2.5;
const FLING_RISE: f32 = 0.7;
/// Heights above the start of the first job's approach path that a waiting piece keeps clear of, m.
const SKY_M: [f32; 3] = [0.12, 0.24, 0.36];
/// Waiting positions relative to the start of the approach path, nearest first, m.
const WAITS_M: [[f32; 3]; 14] = [
    [0.0, 0.0, 0.0],
    [0.0, 0.0, 0.12],
    [0.2, 0.0, 0.06],
    [-0.2, 0.0, 0.06],
    [0.0, 0.2, 0.06],
    [0.0, -0.2, 0.06],
    [0.25, 0.25, 0.1],
    [-0.25, 0.25, 0.1],
    [0.25, -0.25, 0.1],
    [-0.25, -0.25, 0.1],
    [0.4, 0.0, 0.15],
    [-0.4, 0.0, 0.15],
    [0.0, 0.4, 0.15],
    [0.0, -0.4, 0.15],
];

/// A piece to add, and how.
struct Job {
    parts: Parts,
    gripped: BlockIdx,
    target: Isometry3<f32>,
    /// Vector from the target to the start of the approach path, world frame, m.
    way: Vector3<f32>,
}

impl Job {
    /// Returns the pose at the start of the approach path.
    fn entry(&self) -> Isometry3<f32> {
        Translation3::from(self.way) * self.target
    }
}

impl Expert {
    /// Adds the next pieces to the base.
    pub(super) fn add(&mut self, view: &View, base: &Base) -> Vec<Command> {
        // If all parts are placed, only a connection between two of them is missing, and the magnets close it.
        let Some(first) = self.assembly.next(base.side, base.parts) else { return vec![] };
        let Some(job) = self.job(view, base, base.parts, view.piece(first)) else {
            return self.split_off(view, first);
        };
        if let Some(stray) = self.in_the_way(view, base, &job) {
            return vec![self.fling(view, base, stray)];
        }
        let mut commands = vec![self.bring(view, &job)];
        if self.n_grippers > 1 {
            commands.extend(self.second(view, base, &job));
        }
        commands
    }

    /// Returns what the other gripper does while `first` is brought in.
    fn second(&mut self, view: &View, base: &Base, first: &Job) -> Option<Command> {
        let (job, waits) = self.second_job(view, base, first)?;
        Some(match self.yields(view, &job, first) {
            Some(command) => command,
            None if waits => self.wait(view, &job, first),
            None => self.bring(view, &job),
        })
    }

    /// Returns the other gripper's job, and whether it must wait for the first.
    fn second_job(&mut self, view: &View, base: &Base, first: &Job) -> Option<(Job, bool)> {
        let after = base.parts.union(first.parts);
        let next = self.assembly.next(base.side, after)?;
        let piece = view.piece(next);
        if let Some(job) = self.job(view, base, base.parts, piece) {
            let with = base.parts.union(piece);
            let free = self.assembly.is_safe(base.side, with)
                && self.assembly.margin_u(base.side, with) >= MIN_BUILD_MARGIN_U
                && self.assembly.approach(base.side, with, first.parts).is_some()
                && self.apart(view, first, &job);
            return Some((job, !free));
        }
        self.job(view, base, after, piece).map(|job| (job, true))
    }

    /// Returns how to bring `piece` to the base once `placed` stands, or `None` if there is no approach path.
    ///
    /// Of several paths, it takes the first without strays, or else the first.
    fn job(&mut self, view: &View, base: &Base, placed: Parts, piece: Parts) -> Option<Job> {
        if piece.len() > 1 && !self.assembly.is_safe(base.side, placed.union(piece)) {
            return None;
        }
        let gripped = self.gripped(view, piece);
        let part = view.part_of[gripped.get()]?;
        let frame = self.frame_beside(view, base, piece);
        let target = frame * self.place(part);
        let mut first = None;
        for Approach { direction, length_half_units } in self.assembly.approaches(base.side, placed, piece) {
            let length_m = length_half_units as f32 * UNIT_M / 2.0;
            let way = frame.rotation * (Vector3::from(direction.map(|x| x as f32)) * length_m);
            let job = Job { parts: piece, gripped, target, way };
            // A piece halfway in stays on its path, or a stray at the margin would make it dither between two paths.
            let is_coming = way_in(&self.limits, view.pose(gripped), &job).is_some();
            if is_coming || self.in_the_way(view, base, &job).is_none() {
                return Some(job);
            }
            first = first.or(Some(job));
        }
        first
    }

    /// Returns the blueprint's frame implied by the base's block that `piece` will touch.
    fn frame_beside(&self, view: &View, base: &Base, piece: Parts) -> Isometry3<f32> {
        let links = self.blueprint.links();
        let touching = links.iter().filter_map(|link| {
            let (a, b) = (view.part_of[link.a.get()]?, view.part_of[link.b.get()]?);
            let part = match (base.parts.contains(a), base.parts.contains(b)) {
                (true, false) if piece.contains(b) => a,
                (false, true) if piece.contains(a) => b,
                _ => return None,
            };
            Some((link.n_magnet_pairs, part))
        });
        touching.max().map_or(base.frame, |(_, part)| self.frame_of(view, part))
    }

    /// Returns the boxes of a job's piece along its approach path.
    fn swept(&self, view: &View, job: &Job) -> Vec<(Isometry3<f32>, Vector3<f32>)> {
        [0.0, 0.25, 0.5, 0.75, 1.0].into_iter().flat_map(|share| self.boxes_at(view, job, job.way * share)).collect()
    }

    /// Returns the boxes of a job's piece at `offset` from its target.
    fn boxes_at(&self, view: &View, job: &Job, offset: Vector3<f32>) -> Vec<(Isometry3<f32>, Vector3<f32>)> {
        let to_gripped = view.pose(job.gripped).inverse();
        let pose = Translation3::from(offset) * job.target;
        let boxed = |block: BlockIdx| (pose * (to_gripped * view.pose(block)), view.half_extents[block.get()]);
        job.parts.iter().map(|part| boxed(self.block(part))).collect()
    }

    /// Returns whether two pieces can come in at the same time.
    fn apart(&self, view: &View, first: &Job, second: &Job) -> bool {
        let seconds = self.swept(view, second);
        let firsts = self.swept(view, first);
        firsts.iter().all(|(a, half_a)| seconds.iter().all(|(b, half_b)| gap((a, half_a), (b, half_b)) > 0.04))
    }

    /// Returns one step of bringing a piece in.
    fn bring(&self, view: &View, job: &Job) -> Command {
        let load = Load::new(view, job.gripped);
        let from = view.pose(job.gripped);
        let twist = way_in(&self.limits, from, job).unwrap_or_else(|| load.go(view, &self.limits, &job.entry()));
        Command { block: job.gripped, twist }
    }

    /// Returns one step away from the first job's piece, if the two are carried close to each other.
    fn yields(&self, view: &View, job: &Job, first: &Job) -> Option<Command> {
        if !view.is_held(job.gripped) || !view.is_held(first.gripped) {
            return None;
        }
        let close = |a: usize, b: usize| gap(view.solid(self.block(a)), view.solid(self.block(b))) < YIELD_M;
        if !job.parts.iter().any(|a| first.parts.iter().any(|b| close(a, b))) {
            return None;
        }
        let between = view.pose(job.gripped).translation.vector - view.pose(first.gripped).translation.vector;
        let aside = Vector3::new(between.x, between.y, 0.0).try_normalize(0.01).unwrap_or_else(Vector3::x);
        let linear = aside * self.limits.max_speed_mps * 0.5;
        Some(Command { block: job.gripped, twist: Twist { linear, angular: Vector3::zeros() } })
    }

    /// Returns one step of waiting near the start of the approach path, clear of the first job's path.
    fn wait(&self, view: &View, job: &Job, first: &Job) -> Command {
        let load = Load::new(view, job.gripped);
        let mut avoid = self.swept(view, first);
        // The first piece comes down on its path from above.
        let above = SKY_M.map(|height_m| first.way + Vector3::z() * height_m);
        avoid.extend(above.into_iter().flat_map(|offset| self.boxes_at(view, first, offset)));
        let carried = first.parts.iter().map(|part| view.solid(self.block(part)));
        avoid.extend(carried.map(|(pose, half)| (*pose, *half)));
        let mut places = WAITS_M.into_iter().map(|offset| Translation3::from(offset) * job.entry());
        let free = |place: &Isometry3<f32>| !load.hits(view, place, 0.03) && load.is_apart(view, place, &avoid, 0.06);
        let twist = match places.find(free) {
            Some(place) => load.go(view, &self.limits, &place),
            None => Twist { linear: Vector3::z(), angular: Vector3::zeros() },
        };
        Command { block: job.gripped, twist }
    }

    /// Returns a stray in the path of the job's piece: a block that is not held and not part of the base or the job.
    fn in_the_way(&self, view: &View, base: &Base, job: &Job) -> Option<BlockIdx> {
        let swept = self.swept(view, job);
        BlockIdx::all().find(|&block| {
            let part = view.part_of[block.get()];
            let involved = part.is_some_and(|part| base.parts.contains(part) || job.parts.contains(part));
            let other = view.solid(block);
            !involved
                && !view.is_held(block)
                && swept.iter().any(|(pose, half)| gap((pose, half), other) < STRAY_MARGIN_M)
        })
    }

    /// Throws a stray away from the structure and up for one step. The nearest free ground would jump from scene to
    /// scene.
    fn fling(&self, view: &View, base: &Base, stray: BlockIdx) -> Command {
        let [x, y] = self.middle(&base.frame, base.side);
        let at = view.pose(stray).translation;
        let out = Vector3::new(at.x - x, at.y - y, 0.0).try_normalize(0.01).unwrap_or_else(Vector3::x);
        let linear = (out + Vector3::z() * FLING_RISE) * FLING_SPEED_MPS;
        Command { block: stray, twist: Twist { linear, angular: Vector3::zeros() } }
    }
}

/// Returns the motion along the approach path if the piece is on it. The better aligned it is, the farther in it moves.
/// A gradual motion is easier to imitate: a gate that opens at a certain alignment locks out a piece that hovers beside
/// it.
fn way_in(limits: &Limits, from: &Isometry3<f32>, job: &Job) -> Option<Twist> {
    let length = job.way.norm();
    let direction = job.way / length;
    let error = from.translation.vector - job.target.translation.vector;
    let along = error.dot(&direction);
    let aside = (error - direction * along).norm();
    let turn = from.rotation.angle_to(&job.target.rotation);
    let on_the_way = aside <= WIDEST_M && turn <= WIDEST_RAD && (-0.03..=length + 0.03).contains(&along);
    let back = (aside - MAX_ASIDE_M).max(0.0) * ASIDE_SLOPE + (turn - MAX_TURN_RAD).max(0.0) * TURN_SLOPE_M;
    on_the_way.then(|| {
        let left = if along > BRAKE_M + 0.005 {
            (along - ENTRY_SPEED_MPS * CONTROL_DT_S).max(BRAKE_M)
        } else {
            (along - TOUCH_SPEED_MPS * CONTROL_DT_S).max(0.0)
        };
        limits.toward(from, &(Translation3::from(direction * left.max(back.min(length))) * job.target))
    })
}

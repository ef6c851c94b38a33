//! Fetching: which pieces come next, and how each is brought in.

use blueprints::BlockIdx;
use blueprints::assembly::{Approach, MIN_BUILD_MARGIN_U, Parts};
use nalgebra::{Isometry3, Vector3};

use super::motion::{Limits, Load, Twist, gap};
use super::view::View;
use super::{Activity, Base, Command, Expert};

/// Within this of the way's axis a piece may come in all the way, m; further aside it stays back by so many times more.
const MAX_ASIDE_M: f32 = 0.02;
const ASIDE_SLOPE: f32 = 2.0;
/// Within this of its orientation, rad; turned further it stays back by so many meters per radian more.
const MAX_TURN_RAD: f32 = 0.12;
const TURN_SLOPE_M: f32 = 0.2;
/// Further than this from the axis, m, or from its orientation, rad, it is not on its way in.
const WIDEST_M: f32 = 0.06;
const WIDEST_RAD: f32 = 0.5;
/// The way in is fast up to this distance from the place, where the magnets have just caught, m.
const BRAKE_M: f32 = 0.022;
/// Speed of the fast part, m/s; at 2 m/s half of the episodes of `10_000` ended in broken connections.
const ENTRY_SPEED_MPS: f32 = 1.6;
/// Speed of the rest, m/s: once the magnets have snapped, the gripper drags the whole structure along.
const TOUCH_SPEED_MPS: f32 = 0.4;
/// Two carried pieces closer than this part, m.
const YIELD_M: f32 = 0.05;
/// A stray this close to the way in is in the way, m; more than what is kept free on the way to its beginning.
const STRAY_MARGIN_M: f32 = 0.025;
/// A stray leaves with this speed, m/s, and goes up by so many meters per meter aside.
const FLING_SPEED_MPS: f32 = 2.5;
const FLING_RISE: f32 = 0.7;
/// Heights above the beginning of the first job's way that who waits keeps free, m.
const SKY_M: [f32; 3] = [0.12, 0.24, 0.36];
/// Where a piece waits, from the beginning of its way: as near as it may, m.
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

/// A piece to be added and how.
struct Job {
    parts: Parts,
    gripped: BlockIdx,
    target: Isometry3<f32>,
    /// From the target to the beginning of the way in, world frame, m.
    way: Vector3<f32>,
}

impl Expert {
    /// Adds the next pieces to the base.
    pub(super) fn add(&mut self, view: &View, base: &Base) -> (Activity, Vec<Command>) {
        // When all stand, a connection between two of them is still missing: the magnets close it.
        let Some(first) = self.assembly.next(base.side, base.parts) else { return (Activity::Adding, vec![]) };
        let Some(job) = self.job(view, base, base.parts, view.piece(first)) else {
            return (Activity::TakingDown, self.split_off(view, first));
        };
        if let Some(stray) = self.in_the_way(view, base, &job) {
            return (Activity::Clearing, vec![self.fling(view, base, stray)]);
        }
        let mut commands = vec![self.bring(view, &job)];
        if self.n_grippers > 1 {
            commands.extend(self.second(view, base, &job));
        }
        (Activity::Adding, commands)
    }

    /// What the other gripper does while `first` is brought in.
    fn second(&mut self, view: &View, base: &Base, first: &Job) -> Option<Command> {
        let (job, waits) = self.second_job(view, base, first)?;
        Some(match self.yields(view, &job, first) {
            Some(command) => command,
            None if waits => self.wait(view, &job, first),
            None => self.bring(view, &job),
        })
    }

    /// The job of the other gripper, and whether it must wait for the first.
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
        let job = self.job(view, base, after, piece)?;
        Some((job, true))
    }

    /// How to bring `piece` to the base when `placed` stands; `None` if it has no way in.
    ///
    /// Of several ways the first without strays on it; if there is none, the first.
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
            let way = frame.rotation * Self::way_m(direction, length_half_units);
            let job = Job { parts: piece, gripped, target, way };
            // Whoever is half way in goes on, or a stray at the margin would have it dither between two ways.
            let is_coming = way_in(&self.limits, view.pose(gripped), &job).is_some();
            if is_coming || self.in_the_way(view, base, &job).is_none() {
                return Some(job);
            }
            first = first.or(Some(job));
        }
        first
    }

    /// The blueprint's frame as the block of the base has it that `piece` will touch.
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

    /// The boxes of a job's piece along its way in.
    fn swept(&self, view: &View, job: &Job) -> Vec<(Isometry3<f32>, Vector3<f32>)> {
        [0.0, 0.25, 0.5, 0.75, 1.0].into_iter().flat_map(|share| self.boxes_at(view, job, job.way * share)).collect()
    }

    /// The boxes of a job's piece above the beginning of its way in.
    fn at_entry(&self, view: &View, job: &Job, height: f32) -> Vec<(Isometry3<f32>, Vector3<f32>)> {
        self.boxes_at(view, job, job.way + Vector3::z() * height)
    }

    /// The boxes of a job's piece when it is `offset` from its place.
    fn boxes_at(&self, view: &View, job: &Job, offset: Vector3<f32>) -> Vec<(Isometry3<f32>, Vector3<f32>)> {
        let to_gripped = view.pose(job.gripped).inverse();
        let mut pose = job.target;
        pose.translation.vector += offset;
        let boxed = |block: BlockIdx| (pose * (to_gripped * view.pose(block)), view.half_extents[block.get()]);
        job.parts.iter().map(|part| boxed(self.block(part))).collect()
    }

    /// Whether two pieces can come in at the same time.
    fn apart(&self, view: &View, first: &Job, second: &Job) -> bool {
        let seconds = self.swept(view, second);
        let firsts = self.swept(view, first);
        firsts.iter().all(|(a, half_a)| seconds.iter().all(|(b, half_b)| gap((a, half_a), (b, half_b)) > 0.04))
    }

    /// One step of bringing a piece in.
    fn bring(&self, view: &View, job: &Job) -> Command {
        let load = Load::new(view, job.gripped);
        let from = view.pose(job.gripped);
        let twist = way_in(&self.limits, from, job).unwrap_or_else(|| {
            let mut entry = job.target;
            entry.translation.vector += job.way;
            load.go(view, &self.limits, &entry)
        });
        Command { block: job.gripped, twist }
    }

    /// One step away from the piece of the first job, if the two are carried close to each other.
    fn yields(&self, view: &View, job: &Job, first: &Job) -> Option<Command> {
        if !view.is_held(job.gripped) || !view.is_held(first.gripped) {
            return None;
        }
        let close = |a: usize, b: usize| {
            let (a, b) = (self.block(a), self.block(b));
            let (half_a, half_b) = (&view.half_extents[a.get()], &view.half_extents[b.get()]);
            gap((view.pose(a), half_a), (view.pose(b), half_b)) < YIELD_M
        };
        if !job.parts.iter().any(|a| first.parts.iter().any(|b| close(a, b))) {
            return None;
        }
        let between = view.pose(job.gripped).translation.vector - view.pose(first.gripped).translation.vector;
        let aside = Vector3::new(between.x, between.y, 0.0).try_normalize(0.01).unwrap_or_else(Vector3::x);
        let linear = aside * self.limits.max_speed_mps * 0.5;
        Some(Command { block: job.gripped, twist: Twist { linear, angular: Vector3::zeros() } })
    }

    /// One step of waiting near the beginning of the way in, off the way of the first job.
    fn wait(&self, view: &View, job: &Job, first: &Job) -> Command {
        let load = Load::new(view, job.gripped);
        let mut avoid = self.swept(view, first);
        // The first one comes down on its way from above.
        let above: Vec<_> = SKY_M.iter().flat_map(|&height| self.at_entry(view, first, height)).collect();
        avoid.extend(above);
        avoid.extend(first.parts.iter().map(|part| {
            let block = self.block(part);
            (*view.pose(block), view.half_extents[block.get()])
        }));
        let mut entry = job.target;
        entry.translation.vector += job.way;
        let place = WAITS_M.into_iter().map(|[x, y, z]| {
            let mut place = entry;
            place.translation.vector += Vector3::new(x, y, z);
            place
        });
        let free = |place: &Isometry3<f32>| !load.hits(view, place, 0.03) && load.is_apart(view, place, &avoid, 0.06);
        let twist = match place.into_iter().find(free) {
            Some(place) => load.go(view, &self.limits, &place),
            None => Twist { linear: Vector3::z(), angular: Vector3::zeros() },
        };
        Command { block: job.gripped, twist }
    }

    /// A block that is neither in the base nor carried and where the job's piece has to pass.
    fn in_the_way(&self, view: &View, base: &Base, job: &Job) -> Option<BlockIdx> {
        let swept = self.swept(view, job);
        BlockIdx::all().find(|&block| {
            let part = view.part_of[block.get()];
            let involved = part.is_some_and(|part| base.parts.contains(part) || job.parts.contains(part));
            let other = (view.pose(block), &view.half_extents[block.get()]);
            !involved
                && !view.is_held(block)
                && swept.iter().any(|(pose, half)| gap((pose, half), other) < STRAY_MARGIN_M)
        })
    }

    /// One step of a block away from the structure, and up: the nearest free ground would be a leap from scene to scene.
    fn fling(&self, view: &View, base: &Base, stray: BlockIdx) -> Command {
        let [x, y] = self.middle(&base.frame, base.side);
        let middle = Vector3::new(x, y, 0.0);
        let mut out = view.pose(stray).translation.vector - middle;
        out.z = 0.0;
        let out = out.try_normalize(0.01).unwrap_or_else(Vector3::x);
        let linear = (out + Vector3::z() * FLING_RISE) * FLING_SPEED_MPS;
        Command { block: stray, twist: Twist { linear, angular: Vector3::zeros() } }
    }
}

/// The motion along the way in, if the piece is on it: as far in as it is aligned. The more gradual this is, the easier to
/// imitate: a gate that opens at some alignment keeps out whoever hovers beside it.
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
        let mut to = job.target;
        let left = if along > BRAKE_M + 0.005 {
            (along - ENTRY_SPEED_MPS * limits.step_s).max(BRAKE_M)
        } else {
            (along - TOUCH_SPEED_MPS * limits.step_s).max(0.0)
        };
        to.translation.vector += direction * left.max(back.min(length));
        limits.toward(from, &to)
    })
}

//! Views an episode through a camera that follows the construction.

use nalgebra::{Point3, Vector2};
use proto::Scene;

use super::episode::Episode;
use crate::picture::{Block, Camera, Ground, Image, Painter, Rgb, View, Window, corners, holder, of_scene};

/// Loose blocks farther than this from the middle of the goal's blocks, in meters along x or y, are not framed, so that
/// a block that was thrown away does not shrink the others.
const REACH_M: f32 = 1.6;

/// Blocks farther than this from the origin along an axis, in meters, have fallen off the world.
const WORLD_M: f32 = 10.0;

/// Number of steps over which the camera moves: it zooms out this long before a block needs room, and zooms in this
/// long after.
const FOLLOW_STEPS: usize = 14;

/// Look-ahead for a new camera position, in steps, so that the camera can stay there for a while.
const HOLD_STEPS: usize = 3 * FOLLOW_STEPS;

/// The camera moves closer once the required view takes less than this share of the picture's side.
const CLOSER_FROM: f32 = 0.8;

/// Number of steps after the last one until the camera is as close as possible.
pub(super) const SETTLING_STEPS: usize = FOLLOW_STEPS;

/// Margin around the framed blocks, as a share of the height.
const MARGIN: f32 = 0.05;

/// Minimum length in meters that the shorter side of a picture shows, so that two blocks still have visible
/// surroundings.
const MIN_SHOWN_M: f32 = 6.0 * blueprints::UNIT_M;

/// The world of an episode, seen from one side. The camera moves closer as blocks come together.
///
/// The view after each step contains the largest correct piece of the goal, the goal's blocks held by grippers, and its
/// other blocks within [`REACH_M`]. As blocks are joined, fewer lie around, and the structure fills the picture.
#[derive(Clone, Debug)]
pub(super) struct Stage {
    view: Camera,
    ground: Ground,
    margin_px: f32,
    max_px_per_m: f32,
    /// The part of the view shown after each step and while the camera settles.
    windows: Vec<Window>,
}

impl Stage {
    /// Creates a stage that shows an episode in pictures of `size_px` pixels.
    pub(super) fn new(episode: &Episode, size_px: [usize; 2]) -> Self {
        let margin_px = MARGIN * size_px[1] as f32;
        let max_px_per_m = size_px[0].min(size_px[1]) as f32 / MIN_SHOWN_M;
        let framed: Vec<Vec<Block>> = (0..episode.scenes().len()).map(|n_done| framed(episode, n_done)).collect();
        let all: Vec<Block> = framed.iter().flatten().cloned().collect();
        let view = Camera::framing(View::FrontQuarter, &corners(&all), size_px, margin_px, f32::INFINITY);
        let aspect = size_px[0] as f32 / size_px[1].max(1) as f32;
        let needed: Vec<Option<Window>> = framed.iter().map(|blocks| view.window(&corners(blocks))).collect();
        Self { ground: Ground::under(&all), margin_px, max_px_per_m, windows: smooth(&needed, aspect), view }
    }

    /// Returns the camera after `n_done` steps of the shown episode; fractions interpolate between steps.
    pub(super) fn camera(&self, n_done: f32) -> Camera {
        let first = n_done.max(0.0) as usize;
        let share = n_done.max(0.0).fract();
        let at = |step: usize| self.windows.get(step).or(self.windows.last());
        match (at(first), at(first + 1)) {
            (Some(from), Some(to)) => self.view.on(&from.toward(to, share), self.margin_px, self.max_px_per_m),
            _ => self.view.clone(),
        }
    }

    /// Draws a scene of the world after `n_done` steps.
    pub(super) fn picture(&self, painter: &mut Painter, scene: &Scene, n_done: f32) -> Image {
        self.paint(painter, &of_scene(scene), n_done)
    }

    /// Draws these blocks instead of those of a scene.
    pub(super) fn paint(&self, painter: &mut Painter, blocks: &[Block], n_done: f32) -> Image {
        painter.paint(blocks, &self.camera(n_done), self.ground)
    }

    /// Draws a line between two points (m, world) over the image, with opacity 0 to 255 and a dot at its second end.
    pub(super) fn line(image: &mut Image, camera: &Camera, ends: [[f32; 3]; 2], color: Rgb, opacity: u8) {
        let [Some(from), Some(to)] = ends.map(|end| camera.place(&Point3::from(end))) else { return };
        let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
        // Limit the length of lines that extend far outside the picture.
        let n = (dx.abs().max(dy.abs()).ceil()).clamp(1.0, 4000.0);
        let mut dot = |x: f32, y: f32, side: usize| {
            for (i, j) in (0..side).flat_map(|i| (0..side).map(move |j| (i, j))) {
                let (x, y) = (x.round() + i as f32 - side as f32 / 2.0, y.round() + j as f32 - side as f32 / 2.0);
                if x >= 0.0 && y >= 0.0 {
                    image.blend(x as usize, y as usize, color, opacity);
                }
            }
        };
        (0..n as usize).for_each(|i| dot(from[0] + dx * i as f32 / n, from[1] + dy * i as f32 / n, 1));
        dot(to[0], to[1], 4);
    }
}

/// Returns the blocks to frame after `n_done` steps.
fn framed(episode: &Episode, n_done: usize) -> Vec<Block> {
    let scene = &episode.scenes()[n_done];
    let goal = episode.goal().placements();
    let median = |axis: usize| {
        let mut values: Vec<f32> = goal.iter().map(|place| scene.blocks[place.block.get()].position[axis]).collect();
        values.sort_by(f32::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or_default()
    };
    let middle = Vector2::new(median(0), median(1));
    let piece = episode.largest_piece(n_done);
    let is_wanted = |block: &Block| {
        let at = block.pose.translation.vector;
        let is_near = (at.xy() - middle).amax() < REACH_M;
        // These comparisons are false for NaN, so a diverged block counts as far away.
        goal.iter().any(|place| place.block == block.block)
            && at.iter().all(|value| value.abs() < WORLD_M)
            && (is_near || piece.contains(&block.block) || holder(scene, block.block).is_some())
    };
    of_scene(scene).into_iter().filter(is_wanted).collect()
}

/// Returns, for each step and while the camera settles, a window that moves slowly and contains the one needed then.
///
/// Each window is a mean of windows that all contain what is needed, so it does too.
fn smooth(needed: &[Option<Window>], aspect: f32) -> Vec<Window> {
    let held = hold(needed, aspect);
    let mean = |step: usize| {
        let mut sum: Option<(Window, f32)> = None;
        for back in 0..=FOLLOW_STEPS {
            let Some(window) = held.get(step.saturating_sub(back)).or(held.last()).copied().flatten() else { continue };
            // The weight is highest in the middle, so that the camera neither starts nor stops suddenly.
            let weight = (1 + back.min(FOLLOW_STEPS - back)) as f32;
            sum = Some(match sum {
                Some((mean, total)) => (mean.toward(&window, weight / (total + weight)), total + weight),
                None => (window, weight),
            });
        }
        sum.map(|(mean, _)| mean)
    };
    let mut windows: Vec<Window> = Vec::new();
    for step in 0..needed.len() + SETTLING_STEPS {
        // Without visible blocks, the camera stays where it is.
        windows.extend(mean(step).or(windows.last().copied()));
    }
    windows
}

/// Returns, for each step, a window that contains all windows needed until the camera could have followed. It changes
/// only when it is too small or much too large: frames of a camera at rest take a fraction of the bytes, and are easier
/// to watch.
fn hold(needed: &[Option<Window>], aspect: f32) -> Vec<Option<Window>> {
    let union = |from: usize, n_steps: usize| {
        let some = &needed[from..needed.len().min(from + n_steps + 1)];
        some.iter().flatten().copied().reduce(|all, window| all.with(&window))
    };
    let mut held: Option<Window> = None;
    let mut windows = Vec::with_capacity(needed.len());
    for step in 0..needed.len() {
        let (soon, long) = (union(step, FOLLOW_STEPS), union(step, HOLD_STEPS));
        held = match (held, soon, long) {
            // At the last step, nothing moves any more.
            (_, Some(soon), _) if step + 1 == needed.len() => Some(soon),
            (Some(held), Some(soon), Some(long)) => {
                let is_enough = held.with(&soon) == held;
                let is_close = long.height_at(aspect) > CLOSER_FROM * held.height_at(aspect);
                Some(if is_enough && is_close { held } else { long })
            }
            (held, _, long) => held.or(long),
        };
        windows.push(held);
    }
    windows
}

#[cfg(test)]
mod tests {
    use blueprints::{BlockIdx, Blueprint, Catalog};
    use proto::{Joint, Pose, Trajectory};

    use super::super::tests::segment;
    use super::*;
    use crate::picture::of_blueprint;

    const SIZE_PX: [usize; 2] = [640, 360];

    /// Number of steps for which each block is carried.
    const CARRY_STEPS: usize = 5;

    fn goal() -> &'static Blueprint {
        Catalog::builtin().get(&"14_003".parse().unwrap()).unwrap()
    }

    /// An episode in which blocks are carried one by one from their initial place to their place in the structure.
    fn assembly() -> Episode {
        let blocks = of_blueprint(goal());
        let n_steps = CARRY_STEPS * blocks.len();
        let scene = |n_done: usize| {
            let mut scene = segment(0, 4).last_scene;
            let lies = |i: usize| [(i % 4) as f32 * 0.4 - 0.6, (i / 4) as f32 * 0.4 - 0.6, 0.05];
            scene.blocks.iter_mut().enumerate().for_each(|(i, pose)| pose.position = lies(i));
            for (i, block) in blocks.iter().enumerate() {
                let share = (n_done as f32 / CARRY_STEPS as f32 - i as f32).clamp(0.0, 1.0);
                let place = block.pose.translation.vector;
                let [from, to] = [lies(block.block.get()), [place.x - 0.7, place.y - 0.7, place.z]];
                let position = std::array::from_fn(|axis| from[axis] + share * (to[axis] - from[axis]));
                scene.blocks[block.block.get()] = Pose { position, orientation: block.pose.rotation.coords.into() };
            }
            let n_placed = n_done / CARRY_STEPS;
            let is_placed = |block| blocks[..n_placed].iter().any(|placed| placed.block == block);
            let links = goal().links().iter().filter(|link| is_placed(link.a) && is_placed(link.b));
            scene.joints = links.map(|link| Joint { a: link.a, b: link.b, relative: link.relative }).collect();
            scene.grippers[0].as_mut().unwrap().held = blocks.get(n_placed).map(|block| block.block);
            scene
        };
        let mut whole: Trajectory = segment(0, 4);
        whole.task.blueprint = goal().id().clone();
        let step = whole.transitions[0].clone();
        whole.transitions =
            (0..n_steps).map(|n_done| proto::Transition { scene: scene(n_done), ..step.clone() }).collect();
        whole.last_scene = scene(n_steps);
        Episode::new(&whole, goal()).unwrap()
    }

    /// Smallest and largest pixel coordinates of all corners, from the left and from the top.
    fn extent(camera: &Camera, blocks: &[Block]) -> [[f32; 2]; 2] {
        let places: Vec<[f32; 2]> = corners(blocks).iter().map(|corner| camera.place(corner).unwrap()).collect();
        let along = |axis: usize, pick: fn(f32, f32) -> f32| places.iter().map(|at| at[axis]).reduce(pick).unwrap();
        [[along(0, f32::min), along(1, f32::min)], [along(0, f32::max), along(1, f32::max)]]
    }

    /// The share of the picture's width or height that the blocks occupy, whichever is larger.
    fn share(camera: &Camera, blocks: &[Block]) -> f32 {
        let [low, high] = extent(camera, blocks);
        (0..2).map(|axis| (high[axis] - low[axis]) / SIZE_PX[axis] as f32).fold(0.0, f32::max)
    }

    #[test]
    fn what_is_built_stays_in_the_frame_and_fills_it() {
        let episode = assembly();
        let stage = Stage::new(&episode, SIZE_PX);
        for n_done in 0..=episode.n_steps() {
            let blocks = framed(&episode, n_done);
            assert!(goal().placements().iter().all(|at| blocks.iter().any(|block| block.block == at.block)));
            // Also halfway to the next step, in which the held block moves.
            for time in [n_done as f32, n_done as f32 + 0.5] {
                let camera = stage.camera(time);
                let [low, high] = extent(&camera, &blocks);
                let is_inside = |axis: usize| low[axis] >= 0.0 && high[axis] <= SIZE_PX[axis] as f32;
                assert!(is_inside(0) && is_inside(1), "after {time} steps: {low:?} to {high:?}");
                assert!(share(&camera, &blocks) > 0.4, "after {time} steps: {low:?} to {high:?}");
            }
        }
        // At the end nothing else is needed, so the structure fills all but the margins.
        let settled = stage.camera((episode.n_steps() + SETTLING_STEPS) as f32);
        let structure: Vec<Block> = framed(&episode, episode.n_steps());
        assert!((share(&settled, &structure) - (1.0 - 2.0 * MARGIN)).abs() < 0.01, "{}", share(&settled, &structure));
    }

    #[test]
    fn the_camera_moves_smoothly() {
        let episode = assembly();
        let stage = Stage::new(&episode, SIZE_PX);
        for n_done in 0..episode.n_steps() + SETTLING_STEPS {
            let [before, after] = [n_done, n_done + 1].map(|n_done| stage.camera(n_done as f32));
            // The position at which a fixed point appears; a step has three frames.
            let [from, to] = [before, after].map(|camera| camera.place(&Point3::new(-0.7, -0.7, 0.0)).unwrap());
            let moved_px = (to[0] - from[0]).hypot(to[1] - from[1]);
            assert!(moved_px < 0.1 * SIZE_PX[0] as f32, "{moved_px} pixels after {n_done} steps");
        }
    }

    #[test]
    fn a_structure_far_away_is_framed_and_a_loose_block_there_is_not() {
        let mut segment = segment(0, 4);
        let [a, b] = [0, 1].map(|i| BlockIdx::all().nth(i).unwrap());
        let pair = Catalog::builtin().iter().next().unwrap();
        assert!(pair.link(a, b).is_some());
        segment.last_scene.grippers[0].as_mut().unwrap().held = None;
        segment.last_scene.blocks[a.get()].position = [5.0, 0.0, 0.05];
        let far = |segment: &Trajectory| {
            let episode = Episode::new(segment, pair).unwrap();
            framed(&episode, episode.n_steps()).iter().map(|block| block.block).collect::<Vec<_>>()
        };
        // The median of two values is the larger one.
        assert_eq!(far(&segment).len(), 1);
        let relative = pair.link(a, b).unwrap().relative;
        segment.last_scene.joints = vec![Joint { a, b, relative }];
        assert_eq!(far(&segment), [a, b]);
        // Blocks that fell off the world are not framed.
        segment.last_scene.blocks[a.get()].position = [f32::NAN, 0.0, 1e9];
        assert_eq!(far(&segment), [b]);
    }
}

//! Pictures of a world with its goal in a corner.

use blueprints::Blueprint;
use nalgebra::Point3;
use proto::Scene;
use render::picture::{Camera, Ground, Image, Painter, Rgb, View, corners, draw_blueprint, of_scene};

/// Height up to which the camera frames the space above the blocks, m.
const HEADROOM_M: f32 = 0.45;

/// Blocks farther than this from the origin are not framed initially, m.
const REACH_M: f32 = 3.0;

/// Side length of the goal picture as a share of the picture's shorter side.
const GOAL_SHARE: f32 = 0.3;

/// Color of the frame around the goal picture.
const FRAME: Rgb = [190, 196, 206];

/// A fixed camera for an episode, so that only blocks move, and the picture of the goal.
#[derive(Clone, Debug)]
pub(crate) struct Stage {
    camera: Camera,
    ground: Ground,
    goal: Image,
}

impl Stage {
    /// Creates a camera that frames `scene`, for pictures of `size_px` (width, height).
    pub(crate) fn new(scene: &Scene, goal: &Blueprint, size_px: [usize; 2]) -> Self {
        let blocks = of_scene(scene);
        let on_ground: Vec<Point3<f32>> =
            corners(&blocks).into_iter().filter(|corner| corner.coords.norm() < REACH_M).collect();
        let above = on_ground.iter().map(|corner| Point3::new(corner.x, corner.y, HEADROOM_M));
        let points: Vec<Point3<f32>> = on_ground.iter().copied().chain(above).collect();
        let margin_px = 0.02 * size_px[1] as f32;
        let camera = Camera::framing(View::FrontQuarter, &points, size_px, margin_px, f32::INFINITY);
        Self { camera, ground: Ground::under(&blocks), goal: goal_picture(goal, size_px) }
    }

    /// Returns the width and height of the pictures in pixels.
    pub(crate) fn size_px(&self) -> [usize; 2] {
        self.camera.size_px()
    }

    /// Returns the pixels of a scene as RGB bytes, by row from the top.
    pub(crate) fn picture(&self, painter: &mut Painter, scene: &Scene) -> Vec<u8> {
        let mut image = painter.paint(&of_scene(scene), &self.camera, self.ground);
        image.paste(&self.goal, image.width().saturating_sub(self.goal.width()), 0);
        image.pixels().as_flattened().to_vec()
    }
}

/// Paints the goal in a frame.
fn goal_picture(goal: &Blueprint, size_px: [usize; 2]) -> Image {
    let side = (GOAL_SHARE * size_px[0].min(size_px[1]) as f32) as usize;
    let picture = draw_blueprint(&mut Painter::default(), goal, View::FrontQuarter, [side, side]);
    let mut framed = Image::filled(side + 2, side + 2, FRAME);
    framed.paste(&picture, 1, 1);
    framed
}

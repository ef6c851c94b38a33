//! An episode from a fixed camera.

use nalgebra::{Point3, Vector2};
use proto::Scene;

use super::episode::Episode;
use crate::picture::{Block, Camera, Ground, Image, Painter, Rgb, View, corners, of_scene};

/// Blocks farther than this from the center of the others, in meters horizontally or vertically, are not framed, so
/// that a block that was thrown away does not make the others small.
const REACH_M: f32 = 1.6;

/// Margin around the framed blocks, as a share of the height.
const MARGIN: f32 = 0.035;

/// A fixed camera and ground for a whole episode, so that only blocks move.
#[derive(Clone, Debug)]
pub(super) struct Stage {
    camera: Camera,
    ground: Ground,
}

impl Stage {
    /// A stage that shows all steps of an episode in pictures of `size_px` pixels.
    pub(super) fn new(episode: &Episode, size_px: [usize; 2]) -> Self {
        let points = framed(episode);
        let margin_px = MARGIN * size_px[1] as f32;
        let camera = Camera::framing(View::FrontQuarter, &points, size_px, margin_px, f32::INFINITY);
        let start = of_scene(&episode.scenes()[0]);
        Self { camera, ground: Ground::under(&start) }
    }

    /// Draws the world in a scene.
    pub(super) fn picture(&self, painter: &mut Painter, scene: &Scene) -> Image {
        self.paint(painter, &of_scene(scene))
    }

    /// Draws these blocks instead of the scene's.
    pub(super) fn paint(&self, painter: &mut Painter, blocks: &[Block]) -> Image {
        painter.paint(blocks, &self.camera, self.ground)
    }

    /// Draws a line between two points (m, world) over the image, with opacity 0 to 255 and a dot at its second end.
    pub(super) fn line(&self, image: &mut Image, ends: [[f32; 3]; 2], color: Rgb, opacity: u8) {
        let [Some(from), Some(to)] = ends.map(|end| self.camera.place(&Point3::from(end))) else { return };
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

/// Corners of all blocks in all scenes, except for distant ones.
fn framed(episode: &Episode) -> Vec<Point3<f32>> {
    let start = &episode.scenes()[0];
    let median = |axis: usize| {
        let mut values = start.blocks.map(|pose| pose.position[axis]);
        values.sort_by(f32::total_cmp);
        values[values.len() / 2]
    };
    let middle = Vector2::new(median(0), median(1));
    let is_near = |point: &Point3<f32>| (point.coords.xy() - middle).amax() < REACH_M && point.z.abs() < REACH_M;
    episode.scenes().iter().flat_map(|scene| corners(&of_scene(scene))).filter(is_near).collect()
}

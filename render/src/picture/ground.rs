//! The ground at z = 0: a fading grid of unit cells, and soft shadows.

use blueprints::UNIT_M;
use nalgebra::{Matrix3, Point2, Point3, Vector3};

use super::camera::{Camera, Projected};
use super::image::{Image, Rgb, mix};
use super::model::{Block, corners};
use super::raster::scan;

/// Color of the grid lines. The rest stays white, because a tint would double the size of a contact sheet.
const LINE: Rgb = [214, 218, 226];

/// Color and maximum opacity of shadows.
const SHADOW: Rgb = [44, 52, 78];
const SHADOW_OPACITY: f32 = 0.30;

/// Blur radius of shadows in meters, and its maximum in pixels.
const BLUR_M: f32 = 0.012;
const MAX_BLUR_PX: f32 = 24.0;

/// Below this sine of the camera's elevation the ground is drawn as a line.
const FLAT_SINE: f32 = 0.05;

/// The visible part of the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ground {
    /// Center in meters, world frame.
    pub center: Point2<f32>,
    /// Distance from the center at which the ground has faded out, in meters.
    pub radius_m: f32,
}

/// The shadows of a picture; its memory is reused between pictures.
#[derive(Debug, Default)]
pub(super) struct Shadow {
    width: usize,
    /// Shadow by pixel, 0 for light to 255 for full shadow.
    mask: Vec<u8>,
    line: Vec<u8>,
}

/// A rectangle of pixels: columns and rows, start inclusive and end exclusive.
#[derive(Clone, Copy)]
struct Area {
    x: [usize; 2],
    y: [usize; 2],
}

impl Ground {
    /// Returns the ground around and under these blocks.
    pub fn under(blocks: &[Block]) -> Self {
        let all = corners(blocks);
        let Some(first) = all.first() else { return Self { center: Point2::origin(), radius_m: 4.0 * UNIT_M } };
        let (low, high) = all.iter().fold((*first, *first), |(low, high), corner| (low.inf(corner), high.sup(corner)));
        let spread = (high - low).xy().norm();
        Self { center: nalgebra::center(&low, &high).xy(), radius_m: 0.6 * spread + 2.0 * UNIT_M }
    }

    /// Draws the ground on an image of the camera's size.
    pub(super) fn draw(&self, camera: &Camera, image: &mut Image) {
        let Some(at) = camera.project(&Point3::new(self.center.x, self.center.y, 0.0)) else { return };
        if camera.elevation_sine() < FLAT_SINE {
            self.draw_line(camera, at, image);
        } else {
            self.draw_grid(camera, at, image);
        }
    }

    fn draw_line(&self, camera: &Camera, at: Projected, image: &mut Image) {
        let radius_px = self.radius_m * camera.px_per_m;
        for x in 0..image.width() {
            let share = 1.0 - ((x as f32 + 0.5 - at.x) / radius_px).abs();
            let opacity = (share * 2.0).clamp(0.0, 1.0) * 255.0;
            for below in 0..2 {
                image.blend(x, at.y.round().max(0.0) as usize + below, LINE, opacity as u8);
            }
        }
    }

    fn draw_grid(&self, camera: &Camera, at: Projected, image: &mut Image) {
        let Some(to_ground) = to_ground(camera) else { return };
        let on_ground = |x: f32, y: f32| {
            let at = to_ground * Vector3::new(x, y, 1.0);
            Point2::new(at.x / at.z, at.y / at.z)
        };
        // Cells per pixel; one value for the whole image is accurate enough in mild perspective.
        let here = on_ground(at.x, at.y);
        let right = on_ground(at.x + 1.0, at.y) - here;
        let down = on_ground(at.x, at.y + 1.0) - here;
        let px_per_m = [right.x.hypot(down.x), right.y.hypot(down.y)].map(|m_per_px| 1.0 / m_per_px);
        let per_radius_squared = 1.0 / (self.radius_m * self.radius_m);
        let per_unit = 1.0 / UNIT_M;
        for y in 0..image.height() {
            let start = to_ground * Vector3::new(0.5, y as f32 + 0.5, 1.0);
            let step = to_ground.column(0).into_owned();
            for (x, pixel) in image.row_mut(y).iter_mut().enumerate() {
                let at = start + step * x as f32;
                if at.z <= 0.0 {
                    continue;
                }
                let place = [at.x / at.z, at.y / at.z];
                let (from_x, from_y) = (place[0] - self.center.x, place[1] - self.center.y);
                let fade = 1.0 - (from_x * from_x + from_y * from_y) * per_radius_squared;
                if fade <= 0.0 {
                    continue;
                }
                let line_px = |axis: usize| {
                    let cells = place[axis] * per_unit;
                    (cells - nearest_whole(cells)).abs() * UNIT_M * px_per_m[axis]
                };
                let line = (1.1 - line_px(0).min(line_px(1))).clamp(0.0, 1.0);
                if line > 0.0 {
                    *pixel = mix(*pixel, LINE, line * fade);
                }
            }
        }
    }
}

/// Rounds like `f32::round` for numbers below four million, without the slow call on processors that lack the
/// instruction.
fn nearest_whole(x: f32) -> f32 {
    // Adding 1.5 · 2²³ leaves no fractional bits.
    const SHIFT: f32 = 12_582_912.0;
    (x + SHIFT) - SHIFT
}

/// Returns the homography from pixels to the ground; its third coordinate is positive in front of the viewer.
fn to_ground(camera: &Camera) -> Option<Matrix3<f32>> {
    // The origin and the two directions determine a projection, all before the division by depth.
    let column = |x: f32, y: f32| Vector3::from(camera.project_undivided(&Point3::new(x, y, 0.0)));
    let origin = column(0.0, 0.0);
    Matrix3::from_columns(&[column(1.0, 0.0) - origin, column(0.0, 1.0) - origin, origin]).try_inverse()
}

impl Shadow {
    /// Darkens the ground of an image in the shadow of the blocks.
    pub(super) fn draw(&mut self, camera: &Camera, blocks: &[Block], image: &mut Image) {
        if camera.elevation_sine() < FLAT_SINE {
            return;
        }
        let size = [image.width(), image.height()];
        self.width = size[0];
        self.mask.resize(size[0] * size[1], 0);
        let Some(area) = self.cast(camera, blocks, size) else { return };
        let radius = (BLUR_M * camera.px_per_m).clamp(1.0, MAX_BLUR_PX) as usize;
        let grown = |[from, to]: [usize; 2], limit: usize| {
            [from.saturating_sub(2 * radius + 1), (to + 2 * radius + 1).min(limit)]
        };
        let area = Area { x: grown(area.x, size[0]), y: grown(area.y, size[1]) };
        let [width, height] = [area.x, area.y].map(|[from, to]| to - from);
        for _ in 0..2 {
            self.blur((area.y[0]..area.y[1]).map(|y| y * size[0] + area.x[0]), 1, width, radius);
            self.blur((area.x[0]..area.x[1]).map(|x| area.y[0] * size[0] + x), size[0], height, radius);
        }
        for y in area.y[0]..area.y[1] {
            let mask = &mut self.mask[y * self.width..][area.x[0]..area.x[1]];
            for (pixel, shade) in image.row_mut(y)[area.x[0]..area.x[1]].iter_mut().zip(mask.iter()) {
                if *shade > 0 {
                    *pixel = mix(*pixel, SHADOW, SHADOW_OPACITY * f32::from(*shade) / 255.0);
                }
            }
            mask.fill(0);
        }
    }

    /// Marks the shadows of all blocks; returns their bounds.
    fn cast(&mut self, camera: &Camera, blocks: &[Block], size: [usize; 2]) -> Option<Area> {
        let light = camera.light;
        let mut area = Area { x: [size[0], 0], y: [size[1], 0] };
        let onto_ground = |at: Point3<f32>| -> Option<Projected> { camera.project(&(at - light * (at.z / light.z))) };
        for block in blocks {
            // The lit sides cover the same pixels as all sides.
            for side in block.sides().filter(|side| side.normal.dot(&light) > 0.0) {
                let [Some(a), Some(b), Some(c), Some(d)] = side.corners.map(onto_ground) else { continue };
                scan(&[a, b, c, d], size, |y, from, to| {
                    if from < to {
                        self.mask[y * size[0] + from..y * size[0] + to].fill(255);
                        area.x = [area.x[0].min(from), area.x[1].max(to)];
                        area.y = [area.y[0].min(y), area.y[1].max(y + 1)];
                    }
                });
            }
        }
        (area.y[1] > 0).then_some(area)
    }

    /// Blurs lines of `n` values that begin at the `firsts` and go on in steps of `stride`: each value becomes the mean of
    /// those up to `radius` values away, with light beyond the ends.
    fn blur(&mut self, firsts: impl Iterator<Item = usize>, stride: usize, n: usize, radius: usize) {
        let n_averaged = (2 * radius + 1) as u32;
        for first in firsts {
            let line = &mut self.line;
            line.clear();
            line.extend(self.mask[first..].iter().step_by(stride).take(n));
            let mut sum: u32 = line.iter().take(radius).map(|&x| u32::from(x)).sum();
            for (i, out) in self.mask[first..].iter_mut().step_by(stride).take(n).enumerate() {
                sum += line.get(i + radius).map_or(0, |&x| u32::from(x));
                *out = (sum / n_averaged) as u8;
                sum -= i.checked_sub(radius).map_or(0, |i| u32::from(line[i]));
            }
        }
    }
}

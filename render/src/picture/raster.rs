//! Rasterizes flat convex surfaces with a depth test.

use std::ops::Range;

use super::camera::Projected;
use super::image::{Image, Rgb};

/// Samples per pixel along each side.
pub(super) const OVERSAMPLING: usize = 2;

/// Samples of the surfaces drawn so far.
#[derive(Debug, Default)]
pub(super) struct Samples {
    width: usize,
    height: usize,
    /// Inverse depth of the nearest surface at each sample; negative infinity if there is none.
    nearness: Vec<f32>,
    colors: Vec<Rgb>,
    /// Bounds of the rows and columns of samples with a surface.
    rows: Range<usize>,
    columns: Range<usize>,
}

/// A rectangle in space with its own coordinates: the first increases from corner 0 to 1, the second from 0 to 3.
pub(super) struct Surface {
    /// The corners in order around the rectangle, in pixels of the image.
    pub(super) corners: [Projected; 4],
    /// The coordinates at corner 2.
    pub(super) size: [f32; 2],
}

/// A quantity that is linear in the image plane.
#[derive(Clone, Copy)]
struct Linear {
    at_origin: f32,
    per_x: f32,
    per_y: f32,
}

impl Linear {
    fn at(&self, x: f32, y: f32) -> f32 {
        self.at_origin + self.per_x * x + self.per_y * y
    }
}

impl Surface {
    /// Returns the change of the two coordinates at corner 0, per pixel along the image's x and y; `None` if the
    /// surface is seen edge-on.
    pub(super) fn gradients(&self) -> Option<[[f32; 2]; 2]> {
        let [a, b, _, d] = &self.corners;
        let (bx, by, dx, dy) = (b.x - a.x, b.y - a.y, d.x - a.x, d.y - a.y);
        let area = bx * dy - by * dx;
        let [first, second] = self.size;
        (area.abs() > 1e-3)
            .then(|| [[first * dy / area, -first * dx / area], [-second * by / area, second * bx / area]])
    }
}

/// Returns the linear quantity with these values at three corners.
fn linear([a, b, d]: [&Projected; 3], values: [f32; 3]) -> Linear {
    let (bx, by, dx, dy) = (b.x - a.x, b.y - a.y, d.x - a.x, d.y - a.y);
    let (b_value, d_value) = (values[1] - values[0], values[2] - values[0]);
    let area = bx * dy - by * dx;
    let per_x = (b_value * dy - d_value * by) / area;
    let per_y = (d_value * bx - b_value * dx) / area;
    Linear { at_origin: values[0] - per_x * a.x - per_y * a.y, per_x, per_y }
}

/// Calls `row(y, from, to)` for each row of cells whose centers, in columns `from..to`, lie in a convex polygon.
pub(super) fn scan(corners: &[Projected; 4], [width, height]: [usize; 2], mut row: impl FnMut(usize, usize, usize)) {
    // A center on the border belongs to the polygon below or right of it, so that neighbors share no cell.
    let cell = |x: f32, limit: usize| (x - 0.5).ceil().clamp(0.0, limit as f32) as usize;
    let low = corners.iter().map(|at| at.y).fold(f32::INFINITY, f32::min);
    let high = corners.iter().map(|at| at.y).fold(f32::NEG_INFINITY, f32::max);
    for y in cell(low, height)..cell(high, height) {
        let center = y as f32 + 0.5;
        let (mut from, mut to) = (f32::INFINITY, f32::NEG_INFINITY);
        for (i, a) in corners.iter().enumerate() {
            let b = &corners[(i + 1) % 4];
            // Use the same order for both polygons at an edge, so that rounding is the same.
            let (a, b) = if (a.y, a.x) <= (b.y, b.x) { (a, b) } else { (b, a) };
            if a.y <= center && center < b.y {
                let x = a.x + (b.x - a.x) * ((center - a.y) / (b.y - a.y));
                from = from.min(x);
                to = to.max(x);
            }
        }
        if from < to {
            row(y, cell(from, width), cell(to, width));
        }
    }
}

impl Samples {
    /// Removes all surfaces and allocates samples for an image of this size in pixels.
    pub(super) fn clear(&mut self, [width, height]: [usize; 2]) {
        let (width, height) = (width * OVERSAMPLING, height * OVERSAMPLING);
        if (self.width, self.height) == (width, height) {
            let end = self.rows.end * width;
            self.nearness[(self.rows.start * width).min(end)..end].fill(f32::NEG_INFINITY);
        } else {
            (self.width, self.height) = (width, height);
            self.nearness = vec![f32::NEG_INFINITY; width * height];
            self.colors = vec![[0; 3]; width * height];
        }
        // Empty, so that the first surface sets both ends.
        (self.rows, self.columns) = (height..0, width..0);
    }

    /// Draws a surface, which must have [gradients](Surface::gradients), where no earlier one is nearer. `shade` gives
    /// the color at the surface's two coordinates.
    pub(super) fn draw(&mut self, surface: &Surface, shade: impl Fn(f32, f32) -> Rgb) {
        debug_assert!(surface.gradients().is_some(), "a surface seen edge-on");
        let factor = OVERSAMPLING as f32;
        let corners = surface.corners.map(|at| Projected { x: at.x * factor, y: at.y * factor, ..at });
        let [a, b, _, d] = &corners;
        let [first, second] = surface.size;
        let nearness = linear([a, b, d], [a.nearness, b.nearness, d.nearness]);
        let zoom = linear([a, b, d], [a.zoom, b.zoom, d.zoom]);
        let first = linear([a, b, d], [0.0, first * b.zoom, 0.0]);
        let second = linear([a, b, d], [0.0, 0.0, second * d.zoom]);
        let (width, height) = (self.width, self.height);
        scan(&corners, [width, height], |y, from, to| {
            self.rows = self.rows.start.min(y)..self.rows.end.max(y + 1);
            self.columns = self.columns.start.min(from)..self.columns.end.max(to);
            let (x, center) = (from as f32 + 0.5, y as f32 + 0.5);
            let [nearness_0, zoom_0, first_0, second_0] = [nearness, zoom, first, second].map(|q| q.at(x, center));
            let line = y * width + from..y * width + to.max(from);
            let cells = self.nearness[line.clone()].iter_mut().zip(&mut self.colors[line]);
            for (i, (best, color)) in cells.enumerate() {
                let step = i as f32;
                let here = nearness_0 + step * nearness.per_x;
                if here > *best {
                    let scale = 1.0 / (zoom_0 + step * zoom.per_x);
                    let at = [first_0 + step * first.per_x, second_0 + step * second.per_x];
                    *best = here;
                    *color = shade(at[0] * scale, at[1] * scale);
                }
            }
        });
    }

    /// Draws the surfaces on an image of the size passed to `clear`; each pixel is the mean of its samples.
    pub(super) fn resolve(&self, image: &mut Image) {
        for y in self.rows.start / OVERSAMPLING..self.rows.end.div_ceil(OVERSAMPLING) {
            let columns = self.columns.start / OVERSAMPLING..self.columns.end.div_ceil(OVERSAMPLING);
            for (x, pixel) in columns.clone().zip(&mut image.row_mut(y)[columns]) {
                let upper = 2 * y * self.width + 2 * x;
                let four = [upper, upper + 1, upper + self.width, upper + self.width + 1];
                let is_drawn = four.map(|k| self.nearness[k] > f32::NEG_INFINITY);
                if is_drawn == [false; 4] {
                    continue;
                }
                let mut sum = [2_u16; 3];
                for (k, is_drawn) in four.into_iter().zip(is_drawn) {
                    let color = if is_drawn { self.colors[k] } else { *pixel };
                    (0..3).for_each(|i| sum[i] += u16::from(color[i]));
                }
                *pixel = sum.map(|x| (x / 4) as u8);
            }
        }
    }
}

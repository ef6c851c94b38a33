//! Rasterizes shapes with antialiasing.

use png::EncodingError;

use super::drawing::{Anchor, Drawing, Shape};
use crate::picture::{Image, Rgb, Type, WHITE, encode, write};

/// Colors in a PNG; shades of text and bands use some of them.
const N_COLORS: usize = 256;

/// Scanlines per row of pixels for filling polygons.
const N_SCANLINES: usize = 8;

impl Drawing {
    /// Returns the bytes of a PNG file.
    ///
    /// # Errors
    /// Returns an error if a side exceeds the limit of the format.
    pub fn to_png(&self) -> Result<Vec<u8>, EncodingError> {
        encode(&paint(self), N_COLORS)
    }
}

/// Paints the drawing as an image.
pub(super) fn paint(drawing: &Drawing) -> Image {
    let mut image = Image::filled(drawing.width, drawing.height, WHITE);
    for shape in &drawing.shapes {
        match shape {
            Shape::Rect { corner, size, fill } => image.fill(*corner, *size, *fill),
            Shape::Line { points, width, color } => line(&mut image, points, *width, *color),
            Shape::Polygon { points, fill, opacity } => polygon(&mut image, points, *fill, *opacity),
            Shape::Text { text: letters, at, anchor, kind, color } => {
                text(&mut image, letters, *at, *anchor, *kind, *color);
            }
        }
    }
    image
}

/// A part of the image with the coverage of each pixel, 0 to 1.
struct Mask {
    corner: [usize; 2],
    size: [usize; 2],
    cover: Vec<f64>,
}

impl Mask {
    /// Creates a mask of the part around the points with a margin in pixels, clipped to the image.
    fn around(image: &Image, points: &[[f64; 2]], margin: f64) -> Self {
        let span = |axis: usize, side: usize| {
            let places = points.iter().map(|point| point[axis]);
            let low = places.clone().fold(f64::INFINITY, f64::min) - margin;
            let high = places.fold(f64::NEG_INFINITY, f64::max) + margin;
            // Casts from floats saturate; an empty list becomes an empty span.
            let (low, high) = (low.floor().max(0.0) as usize, (high.ceil().max(0.0) as usize).min(side));
            (low.min(side), high.saturating_sub(low))
        };
        let ((left, width), (top, height)) = (span(0, image.width()), span(1, image.height()));
        Self { corner: [left, top], size: [width, height], cover: vec![0.0; width * height] }
    }

    fn blend_into(&self, image: &mut Image, color: Rgb, opacity: f64) {
        let ([left, top], [width, _]) = (self.corner, self.size);
        for (i, cover) in self.cover.iter().enumerate().filter(|(_, cover)| **cover > 0.0) {
            image.blend(left + i % width, top + i / width, color, (cover.min(1.0) * opacity + 0.5) as u8);
        }
    }
}

/// Covers each pixel by the distance of its center from the line; joints are not covered twice.
fn line(image: &mut Image, points: &[[f64; 2]], width: f64, color: Rgb) {
    let margin = width / 2.0 + 1.0;
    let mut mask = Mask::around(image, points, margin);
    let ([left, top], [n_columns, _]) = (mask.corner, mask.size);
    for ends in points.windows(2) {
        let part = Mask::around(image, ends, margin);
        for y in part.corner[1]..part.corner[1] + part.size[1] {
            for x in part.corner[0]..part.corner[0] + part.size[0] {
                let distance = distance([x as f64 + 0.5, y as f64 + 0.5], ends[0], ends[1]);
                let cover = (width / 2.0 + 0.5 - distance).clamp(0.0, 1.0);
                let known = &mut mask.cover[(y - top) * n_columns + (x - left)];
                *known = known.max(cover);
            }
        }
    }
    mask.blend_into(image, color, 255.0);
}

/// Returns the distance from a point to the nearest point of a segment.
fn distance(point: [f64; 2], from: [f64; 2], to: [f64; 2]) -> f64 {
    let along = [to[0] - from[0], to[1] - from[1]];
    let away = [point[0] - from[0], point[1] - from[1]];
    let length2 = along[0] * along[0] + along[1] * along[1];
    let share = if length2 > 0.0 { ((away[0] * along[0] + away[1] * along[1]) / length2).clamp(0.0, 1.0) } else { 0.0 };
    (away[0] - share * along[0]).hypot(away[1] - share * along[1])
}

/// Fills each scanline between the first and second crossing with the edges, the third and fourth, and so on.
fn polygon(image: &mut Image, points: &[[f64; 2]], fill: Rgb, opacity: u8) {
    let mut mask = Mask::around(image, points, 0.0);
    let ([left, top], [n_columns, n_rows]) = (mask.corner, mask.size);
    let next = points.iter().cycle().skip(1);
    let edges: Vec<([f64; 2], [f64; 2])> = points.iter().copied().zip(next.copied()).collect();
    for scanline in 0..n_rows * N_SCANLINES {
        let y = top as f64 + (scanline as f64 + 0.5) / N_SCANLINES as f64;
        let crossing = |&(a, b): &([f64; 2], [f64; 2])| {
            ((a[1] <= y) != (b[1] <= y)).then(|| a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]))
        };
        let mut crossings: Vec<f64> = edges.iter().filter_map(crossing).collect();
        crossings.sort_by(f64::total_cmp);
        let row = &mut mask.cover[scanline / N_SCANLINES * n_columns..][..n_columns];
        for pair in crossings.chunks_exact(2) {
            let (from, to) = ((pair[0] - left as f64).max(0.0), pair[1] - left as f64);
            for (x, cover) in row.iter_mut().enumerate().skip(from as usize).take_while(|(x, _)| (*x as f64) < to) {
                let inside = to.min(x as f64 + 1.0) - from.max(x as f64);
                *cover += inside.max(0.0) / N_SCANLINES as f64;
            }
        }
    }
    mask.blend_into(image, fill, f64::from(opacity));
}

fn text(image: &mut Image, text: &str, [x, y]: [f64; 2], anchor: Anchor, kind: Type, color: Rgb) {
    let (width, height) = (kind.width(text), kind.height());
    let back = |place: f64, by: usize| (place - by as f64 / 2.0).round().max(0.0) as usize;
    let top = back(y, height);
    match anchor {
        Anchor::Start => write(image, [x.round().max(0.0) as usize, top], text, kind, color),
        Anchor::Middle => write(image, [back(x, width), top], text, kind, color),
        Anchor::End => write(image, [(x - width as f64).round().max(0.0) as usize, top], text, kind, color),
        Anchor::Turned => {
            let mut level = Image::filled(width, height, WHITE);
            write(&mut level, [0, 0], text, kind, [0; 3]);
            let (left, top) = (back(x, height), back(y, width));
            for (i, [ink, ..]) in level.pixels().iter().enumerate() {
                let (along, across) = (i % level.width(), i / level.width());
                image.blend(left + across, top + (level.width() - 1 - along), color, 255 - ink);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn painted(draw: impl FnOnce(&mut Drawing)) -> Image {
        let mut drawing = Drawing::new(8, 6);
        draw(&mut drawing);
        paint(&drawing)
    }

    fn row(image: &Image, y: usize) -> Vec<u8> {
        (0..image.width()).map(|x| image.get(x, y).unwrap()[0]).collect()
    }

    #[test]
    fn polygon_covers_pixels_partially() {
        // From x = 1.5 to 4 and y = 1 to 3: half of the second pixel, all of the third and fourth.
        let corners = vec![[1.5, 1.0], [4.0, 1.0], [4.0, 3.0], [1.5, 3.0]];
        let image = painted(|drawing| drawing.polygon(corners, [0; 3], 255));
        assert_eq!(row(&image, 0), [255; 8]);
        for y in [1, 2] {
            assert_eq!(row(&image, y), [255, 127, 0, 0, 255, 255, 255, 255]);
        }
        assert_eq!(row(&image, 3), [255; 8]);
    }

    #[test]
    fn line_has_its_width_and_uniform_joints() {
        // Width 2 around y = 3: rows 2 and 3 are full, and the rows next to them are empty.
        let points = vec![[2.5, 3.0], [4.5, 3.0], [6.5, 3.0]];
        let image = painted(|drawing| drawing.line(points, 2.0, [0; 3]));
        for (y, expected) in [(1, 255), (2, 0), (3, 0), (4, 255)] {
            assert_eq!(image.get(4, y).unwrap()[0], expected, "row {y}");
        }
    }

    #[test]
    fn shapes_outside_are_clipped() {
        let far = vec![[-5.0, -5.0], [99.0, -5.0], [99.0, 99.0], [-5.0, 99.0]];
        let image = painted(|drawing| {
            drawing.polygon(far.clone(), [7; 3], 255);
            drawing.line(far, 3.0, [9; 3]);
            drawing.line(Vec::new(), 3.0, [9; 3]);
        });
        assert!(image.pixels().iter().all(|pixel| *pixel == [7; 3]));
    }
}

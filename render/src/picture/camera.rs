//! The camera: views, framing, and projection.

use nalgebra::{Isometry3, Point3, Vector3};

/// A view of a structure. The front is the side of −y, so that +x is on the right.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum View {
    /// From the front, right and above, in mild perspective.
    FrontQuarter,
    /// From the back, left and above, in mild perspective.
    BackQuarter,
    /// Along +y, without perspective.
    Front,
    /// Along −z, +y pointing up, without perspective.
    Top,
}

/// A view of a part of the world in an image of fixed size.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    size_px: [usize; 2],
    target: Point3<f32>,
    /// Unit vectors of the image: right, up, and toward the viewer.
    axes: [Vector3<f32>; 3],
    /// Inverse distance from the viewer to the target in 1/m; 0 without perspective.
    closeness: f32,
    /// Pixels per meter at the target.
    pub(super) px_per_m: f32,
    /// Position of the target, in pixels from the upper left corner.
    center_px: [f32; 2],
    /// Unit vector toward the light: above, and left of and slightly behind the viewer.
    pub(super) light: Vector3<f32>,
}

/// A rectangle in the image plane of a view, in meters at the camera's target: right of the target, and below it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Window {
    /// Left and upper side.
    pub(crate) low: [f32; 2],
    /// Right and lower side.
    pub(crate) high: [f32; 2],
}

/// A projected point. Each field is linear in the image plane along any flat surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Projected {
    /// Pixels from the left.
    pub(super) x: f32,
    /// Pixels from the top.
    pub(super) y: f32,
    /// Inverse depth; larger is nearer.
    pub(super) nearness: f32,
    /// Magnification relative to the target; multiplied by it, surface attributes are linear.
    pub(super) zoom: f32,
}

/// Eye distance in perspective views relative to the framed size, large enough to keep parallels nearly parallel.
const EYE_DISTANCES: f32 = 3.5;

/// Sine of the elevation above which the ground looks like a map: the light comes steeply from the map's upper left,
/// for short shadows.
const MAP_SINE: f32 = 0.9;

/// Near clipping distance, as a share of the eye's distance from the target.
const NEAREST: f32 = 0.05;

impl View {
    /// Returns the name in captions.
    pub fn caption(self) -> &'static str {
        match self {
            Self::FrontQuarter => "front right",
            Self::BackQuarter => "back left",
            Self::Front => "front",
            Self::Top => "top",
        }
    }

    /// Returns the angle around z from the front toward +x, and the angle above the ground, in degrees.
    fn angles_deg(self) -> [f32; 2] {
        match self {
            Self::FrontQuarter => [32.0, 28.0],
            Self::BackQuarter => [212.0, 28.0],
            Self::Front => [0.0, 0.0],
            Self::Top => [0.0, 90.0],
        }
    }
}

impl Camera {
    /// Creates a camera for an image of `width` × `height` pixels that shows all `points` (m, world) as large as
    /// possible with `margin_px` pixels on each side and at most `max_px_per_m` pixels per meter.
    pub fn framing(
        view: View,
        points: &[Point3<f32>],
        [width, height]: [usize; 2],
        margin_px: f32,
        max_px_per_m: f32,
    ) -> Self {
        let [around, above] = view.angles_deg().map(f32::to_radians);
        let right = Vector3::new(around.cos(), around.sin(), 0.0);
        let outwards = Vector3::new(around.sin(), -around.cos(), 0.0);
        let back = outwards * above.cos() + Vector3::z() * above.sin();
        let light = if above.sin() > MAP_SINE {
            Vector3::z() - right * 0.2 - outwards * 0.16
        } else {
            Vector3::z() - right * 0.42 + outwards * 0.34
        };
        let (target, radius) = ball_around(points);
        let has_perspective = matches!(view, View::FrontQuarter | View::BackQuarter);
        let mut camera = Self {
            size_px: [width, height],
            target,
            axes: [right, back.cross(&right), back],
            closeness: if has_perspective { 1.0 / (EYE_DISTANCES * 2.0 * radius) } else { 0.0 },
            px_per_m: 1.0,
            center_px: [0.0; 2],
            light: light.normalize(),
        };
        match camera.window(points) {
            Some(window) => camera.on(&window, margin_px, max_px_per_m),
            None => {
                camera.center_px = [width, height].map(|side| 0.5 * side as f32);
                camera
            }
        }
    }

    /// Returns the smallest rectangle around all `points` (m, world) that are in front of the viewer.
    pub(crate) fn window(&self, points: &[Point3<f32>]) -> Option<Window> {
        let placed = points.iter().filter_map(|point| self.place(point)).map(|px| {
            let place = std::array::from_fn(|axis| (px[axis] - self.center_px[axis]) / self.px_per_m);
            Window { low: place, high: place }
        });
        placed.reduce(|all, window| all.with(&window))
    }

    /// Returns the same view of this part of its image plane: as large as possible, with `margin_px` pixels on each
    /// side and at most `max_px_per_m` pixels per meter.
    ///
    /// This moves the image rather than the viewer, so that parallels and verticals are the same in all pictures.
    pub(crate) fn on(&self, window: &Window, margin_px: f32, max_px_per_m: f32) -> Self {
        let Window { low, high } = window;
        let sides = self.size_px.map(|side| side as f32);
        let room = |axis: usize| (sides[axis] - 2.0 * margin_px).max(1.0) / (high[axis] - low[axis]).max(1e-6);
        let px_per_m = room(0).min(room(1)).min(max_px_per_m);
        let center_px = std::array::from_fn(|axis| 0.5 * (sides[axis] - px_per_m * (low[axis] + high[axis])));
        Self { px_per_m, center_px, ..self.clone() }
    }

    /// Returns the width and height of the image in pixels.
    pub fn size_px(&self) -> [usize; 2] {
        self.size_px
    }

    /// Returns the sine of the angle between the line of sight at the target and the ground.
    pub(super) fn elevation_sine(&self) -> f32 {
        self.axes[2].z
    }

    /// Returns the cosine of the angle between a unit vector and the direction to the viewer, 0 if it points away.
    pub(super) fn facing(&self, normal: &Vector3<f32>) -> f32 {
        normal.dot(&self.axes[2]).max(0.0)
    }

    /// Returns the distance by which a block is in front of the target, in meters.
    pub(super) fn nearness(&self, pose: &Isometry3<f32>) -> f32 {
        self.axes[2].dot(&(Point3::from(pose.translation.vector) - self.target))
    }

    /// Returns whether the outer side of a surface through `point` with the outward `normal` faces the camera.
    pub(super) fn faces(&self, point: &Point3<f32>, normal: &Vector3<f32>) -> bool {
        // The direction from the point to the eye, divided by the eye's distance, which may be infinite.
        let to_eye = self.axes[2] - (point - self.target) * self.closeness;
        normal.dot(&to_eye) > 1e-6
    }

    /// Projects a point (m, world) to pixels from the upper left corner; `None` beside or behind the viewer.
    pub(crate) fn place(&self, point: &Point3<f32>) -> Option<[f32; 2]> {
        self.project(point).map(|at| [at.x, at.y])
    }

    /// Projects a point (m, world); `None` behind the viewer.
    pub(super) fn project(&self, point: &Point3<f32>) -> Option<Projected> {
        let [x, y, depth] = self.project_undivided(point);
        if depth.is_nan() || depth < NEAREST {
            return None;
        }
        let zoom = 1.0 / depth;
        let nearness = self.axes[2].dot(&(point - self.target)) * zoom;
        Some(Projected { x: x * zoom, y: y * zoom, nearness, zoom })
    }

    /// Returns homogeneous coordinates: the position in pixels times the depth, and the depth (1 at the target).
    pub(super) fn project_undivided(&self, point: &Point3<f32>) -> [f32; 3] {
        let from_target = point - self.target;
        let [right, up, back] = self.axes.map(|axis| axis.dot(&from_target));
        let depth = 1.0 - back * self.closeness;
        [self.center_px[0] * depth + self.px_per_m * right, self.center_px[1] * depth - self.px_per_m * up, depth]
    }
}

impl Window {
    /// Returns the smallest rectangle around both.
    pub(crate) fn with(&self, other: &Self) -> Self {
        Self {
            low: std::array::from_fn(|axis| self.low[axis].min(other.low[axis])),
            high: std::array::from_fn(|axis| self.high[axis].max(other.high[axis])),
        }
    }

    /// Returns the height of the smallest picture with this aspect ratio (width / height) that contains the window.
    pub(crate) fn height_at(&self, aspect: f32) -> f32 {
        let [width, height] = [0, 1].map(|axis| self.high[axis] - self.low[axis]);
        height.max(width / aspect)
    }

    /// Interpolates the sides from those of `self` to those of `other` at a `share` of 1.
    pub(crate) fn toward(&self, other: &Self, share: f32) -> Self {
        let between =
            |from: [f32; 2], to: [f32; 2]| std::array::from_fn(|axis| from[axis] + share * (to[axis] - from[axis]));
        Self { low: between(self.low, other.low), high: between(self.high, other.high) }
    }
}

/// Returns the center and radius (at least a millimeter) of the ball around the points' bounding box.
fn ball_around(points: &[Point3<f32>]) -> (Point3<f32>, f32) {
    let Some(first) = points.first() else { return (Point3::origin(), 1.0) };
    let (low, high) = points.iter().fold((*first, *first), |(low, high), point| (low.inf(point), high.sup(point)));
    (nalgebra::center(&low, &high), (0.5 * (high - low).norm()).max(1e-3))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cube_corners() -> Vec<Point3<f32>> {
        (0..8).map(|k| Point3::new((k & 1) as f32, (k >> 1 & 1) as f32, (k >> 2) as f32)).collect()
    }

    #[test]
    fn views_project_axes_as_documented() {
        let check = |view: View, point: [f32; 3], expected: [f32; 2], nearness: f32| {
            // 10 pixels remain for the unit cube, so a meter is 10 pixels; its center is that of the image.
            let camera = Camera::framing(view, &cube_corners(), [14, 16], 2.0, 1000.0);
            let at = camera.project(&Point3::from(point)).unwrap();
            let off = (at.x - expected[0]).abs() + (at.y - expected[1]).abs() + (at.nearness - nearness).abs();
            assert!(off < 1e-4, "{view:?}: {point:?} lands at {at:?}");
        };
        check(View::Front, [0.0, 0.0, 0.0], [2.0, 13.0], 0.5);
        check(View::Front, [1.0, 0.5, 1.0], [12.0, 3.0], 0.0);
        check(View::Top, [0.0, 0.0, 1.0], [2.0, 13.0], 0.5);
        check(View::Top, [1.0, 1.0, 0.0], [12.0, 3.0], -0.5);
    }

    #[test]
    fn framing_leaves_exactly_the_margin() {
        for view in [View::FrontQuarter, View::BackQuarter, View::Front, View::Top] {
            let camera = Camera::framing(view, &cube_corners(), [100, 100], 10.0, 1000.0);
            let landed: Vec<_> = cube_corners().iter().map(|point| camera.project(point).unwrap()).collect();
            let span = |of: fn(&Projected) -> f32| {
                let values = landed.iter().map(of);
                [values.clone().fold(f32::INFINITY, f32::min), values.fold(f32::NEG_INFINITY, f32::max)]
            };
            let ([left, right], [top, bottom]) = (span(|at| at.x), span(|at| at.y));
            assert!(((right - left).max(bottom - top) - 80.0).abs() < 1e-3, "{view:?}");
            assert!((left + right - 100.0).abs() < 1e-3 && (top + bottom - 100.0).abs() < 1e-3, "{view:?}");
        }
    }

    #[test]
    fn perspective_enlarges_near_points_and_clips_behind_the_eye() {
        let camera = Camera::framing(View::FrontQuarter, &cube_corners(), [100, 100], 10.0, 1000.0);
        let near = camera.project(&Point3::new(1.0, 0.0, 1.0)).unwrap();
        let far = camera.project(&Point3::new(0.0, 1.0, 0.0)).unwrap();
        assert!(near.zoom > 1.0 && far.zoom < 1.0 && near.nearness > far.nearness, "{near:?} {far:?}");
        assert_eq!(camera.project(&Point3::new(20.0, -40.0, 30.0)), None);
        assert_eq!(camera.project(&Point3::new(f32::NAN, 0.0, 0.0)), None);
    }
}

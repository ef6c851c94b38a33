//! The texture of a block's side: its lit color, dark edges, and a disc for each magnet.
//!
//! It is a pure function of the position on the side, so that no coplanar surfaces compete in the depth test.

use blueprints::UNIT_M;

use super::camera::Camera;
use super::image::{Rgb, WHITE, mix};
use super::model::{Block, Side};
use super::raster::{Samples, Surface};

/// Color of positive magnets.
pub(super) const POSITIVE_COLOR: Rgb = [208, 40, 46];

/// Color of negative magnets.
pub(super) const NEGATIVE_COLOR: Rgb = [32, 82, 196];

/// Radius of a magnet's disc, and of its light rim, in units.
const MAGNET_RADIUS_U: f32 = 0.19;
const RIM_RADIUS_U: f32 = 0.235;

/// Half the length and half the width of the strokes of a magnet's sign, in units.
const SIGN_HALF_U: [f32; 2] = [0.105, 0.028];

/// Minimum number of pixels per unit for drawing signs; the same for all sides of a picture.
const MIN_SIGN_PX: f32 = 40.0;

/// Width of edges in units: plain edges, and frames.
const EDGE_U: f32 = 0.025;
const FRAME_U: f32 = 0.13;

/// Minimum width of an edge in pixels; two edges meet at the border of two blocks.
const MIN_EDGE_PX: f32 = 0.7;

/// The texture of a side as a function of two coordinates in units.
struct Texture {
    cells: [f32; 2],
    edge_u: [f32; 2],
    edge: Rgb,
    /// The side's color.
    base: Rgb,
    rim: Rgb,
    magnet: Rgb,
    sign: Sign,
    /// Whether magnets are omitted.
    is_bare: bool,
}

enum Sign {
    None,
    Plus,
    /// Along the first or the second coordinate.
    Minus(usize),
}

/// Draws a side of `block` if it faces the camera.
pub(super) fn draw(samples: &mut Samples, camera: &Camera, block: &Block, side: &Side) {
    if !camera.faces(&side.corners[0], &side.normal) {
        return;
    }
    let [Some(a), Some(b), Some(c), Some(d)] = side.corners.map(|corner| camera.project(&corner)) else { return };
    let surface = Surface { corners: [a, b, c, d], size: side.cells };
    if let Some(texture) = Texture::new(camera, block, side, &surface) {
        samples.draw(&surface, |u, v| texture.at([u, v]));
    }
}

fn lit(color: Rgb, brightness: f32) -> Rgb {
    color.map(|x| (f32::from(x) * brightness).round().clamp(0.0, 255.0) as u8)
}

impl Texture {
    fn new(camera: &Camera, block: &Block, side: &Side, surface: &Surface) -> Option<Self> {
        let gradients = surface.gradients()?;
        let from_light = side.normal.dot(&camera.light).max(0.0);
        let shine = 0.56 + 0.36 * from_light + 0.16 * camera.facing(&side.normal) + 0.04 * side.normal.z;
        // At most its own color, so that it matches legends.
        let shine = shine.min(1.0);
        // Magnets keep more of their color in the shade, because it distinguishes the poles.
        let glow = 0.5 + 0.5 * shine;
        let base = lit(block.color(), shine);
        let (breadth_u, edge) = match (block.frame, block.shade) {
            (None, _) => (EDGE_U, mix(base, [30, 32, 44], 0.72)),
            (Some(color), None) => (FRAME_U, color),
            // Use a narrower frame, so that enough of a small block's shade remains.
            (Some(color), Some(_)) => (0.6 * FRAME_U, color),
        };
        let units_per_px = gradients.map(|[x, y]| x.hypot(y));
        // Foreshortening would narrow the edges of an oblique side.
        let edge_u = units_per_px.map(|per_px| breadth_u.max(MIN_EDGE_PX * per_px));
        let has_sign = camera.px_per_m * UNIT_M >= MIN_SIGN_PX;
        // The stroke of a minus lies along the coordinate that changes less from top to bottom.
        let [first, second] = gradients;
        let level = usize::from(first[1].abs() * units_per_px[1] > second[1].abs() * units_per_px[0]);
        let sign = match (has_sign, side.is_positive) {
            (false, _) => Sign::None,
            (true, true) => Sign::Plus,
            (true, false) => Sign::Minus(level),
        };
        let magnet = lit(if side.is_positive { POSITIVE_COLOR } else { NEGATIVE_COLOR }, glow);
        Some(Self {
            cells: side.cells,
            edge_u,
            edge,
            base,
            rim: mix(base, lit(WHITE, glow), 0.8),
            magnet,
            sign,
            is_bare: block.shade.is_some(),
        })
    }

    #[inline(always)]
    fn at(&self, place: [f32; 2]) -> Rgb {
        let is_edge = |i: usize| place[i].min(self.cells[i] - place[i]) < self.edge_u[i];
        if is_edge(0) || is_edge(1) {
            return self.edge;
        }
        if self.is_bare {
            return self.base;
        }
        // Places are positive here, so cutting off decimals finds the cell.
        let from_center = place.map(|x| (x - (x as u32) as f32 - 0.5).abs());
        let distance_squared = from_center[0] * from_center[0] + from_center[1] * from_center[1];
        if distance_squared >= RIM_RADIUS_U * RIM_RADIUS_U {
            return self.base;
        }
        if distance_squared >= MAGNET_RADIUS_U * MAGNET_RADIUS_U {
            return self.rim;
        }
        let is_stroke = |along: usize| from_center[along] < SIGN_HALF_U[0] && from_center[1 - along] < SIGN_HALF_U[1];
        let is_sign = match self.sign {
            Sign::None => false,
            Sign::Plus => is_stroke(0) || is_stroke(1),
            Sign::Minus(along) => is_stroke(along),
        };
        if is_sign { self.rim } else { self.magnet }
    }
}

//! Pictures of blocks by a small software rasterizer: pixels as a function of poses, with no I/O and no clock.
//!
//! Reading order: `model` (blocks) → `camera` → `raster` (surfaces → samples with a depth test) → `texture` (sides of
//! blocks) → `ground` → `painter` (the whole picture) → `text` and `sheet` (pictures with text) → `palette` and `png`
//! (encoding).

mod camera;
mod ground;
pub(crate) mod image;
mod model;
mod painter;
pub(crate) mod palette;
mod png;
mod raster;
mod sheet;
#[cfg(test)]
mod tests;
pub(crate) mod text;
mod texture;

pub use camera::{Camera, View};
pub use ground::Ground;
pub use image::{Image, Rgb, WHITE};
pub use model::{Block, GRIPPER_COLORS, TYPE_COLORS, corners, of_blueprint, of_scene};
pub use painter::Painter;
pub use png::encode;
pub use sheet::{MAX_TILES, card, draw_blueprint, sheet};

pub(crate) use camera::Window;
pub(crate) use image::mix;
pub(crate) use model::holder;

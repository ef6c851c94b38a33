//! The pictures of a training that the paper shows, from the passes of a history, as SVG and PNG.
//!
//! Reading order: [`runlog::series`] (what is shown) → `heat` and `curves` (where it stands) → `drawing` (shapes) → `svg` and
//! `raster`; [`groups`] makes tables. No plotting library: of those at hand none draws a heat map with labeled rows, and
//! their texts need fonts that the system may lack. The letters are those of [`crate::picture`].

mod axis;
mod color;
mod curves;
mod drawing;
pub mod groups;
mod heat;
mod raster;
mod svg;

pub use curves::{MAX_RUNS, comparison, curves};
pub use drawing::Drawing;
pub use heat::{difference_map, success_map};

#[cfg(test)]
mod tests;

//! The paper's plots of a training run, from the evaluations of a history, as SVG and PNG.
//!
//! Reading order: [`runlog::series`] (data) → `heat` and `curves` (layout) → `drawing` (shapes) → `svg` and `raster`;
//! [`groups`] makes tables. No plotting library is used: none of the available ones draws a heat map with labeled rows,
//! and their text needs fonts that the system may lack. The font is that of [`crate::picture`].

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

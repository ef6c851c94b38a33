//! Shapes drawn by rule, to be filled with blocks.

mod buildings;
mod furniture;
mod letters;
mod records;
mod spine;

use std::collections::BTreeSet;

use super::Style;
use super::brick::{Brick, Cell, Stock};
use super::dice::Dice;

/// A shape and its description.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Sketch {
    pub(super) cells: BTreeSet<Cell>,
    pub(super) words: String,
}

impl Sketch {
    fn new(words: &str) -> Self {
        Self { cells: BTreeSet::new(), words: words.to_owned() }
    }

    /// Adds a cuboid; does nothing if a side is not positive.
    fn add(&mut self, low: Cell, size: [i32; 3]) {
        self.cells.extend(Brick { type_idx: 0, low, size }.cells());
    }

    pub(super) fn extent(&self, axis: usize) -> i32 {
        let along = || self.cells.iter().map(|cell| cell[axis]);
        along().max().unwrap_or(0) - along().min().unwrap_or(0) + 1
    }

    /// Returns the sketch if it has exactly that volume, otherwise `None`.
    fn of_volume(self, volume: i32) -> Option<Self> {
        (self.cells.len() as i32 == volume).then_some(self)
    }
}

/// Draws a shape of the style for `n_blocks` blocks; `None` if this draw failed.
///
/// `idea` is any number; it selects one of the variants of a record style.
pub(super) fn sketch(style: Style, n_blocks: usize, idea: usize, dice: &mut Dice) -> Option<Sketch> {
    let (least, most) = Stock::full().volume_range(n_blocks);
    let volume = dice.between(least, most);
    match style {
        // Grown block by block instead.
        Style::Any => None,
        Style::Tower => buildings::tower(volume, dice),
        Style::Wall => buildings::wall(volume, dice),
        Style::Arch => buildings::arch(volume, dice),
        Style::Bridge => buildings::bridge(volume, dice),
        Style::Stairs => buildings::stairs(volume, dice),
        Style::Pyramid => buildings::pyramid(volume, dice),
        Style::Table => furniture::table(volume, dice),
        Style::Ring => furniture::ring(volume, dice),
        Style::Cross => furniture::cross(volume, dice),
        Style::Letter => letters::letter(volume, dice),
        Style::Spine => spine::spine(volume, dice),
        Style::Longest => records::longest(n_blocks, idea, dice),
        Style::Tallest => records::tallest(n_blocks, idea, dice),
    }
}

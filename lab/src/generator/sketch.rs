//! Shapes drawn by rule, to be filled with blocks.

mod buildings;
mod furniture;
mod letters;
mod records;
mod shape;

use super::Style;
use super::brick::Stock;
use super::dice::Dice;
use shape::Sketch;

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
        Style::Longest => records::longest(n_blocks, idea, dice),
        Style::Tallest => records::tallest(n_blocks, idea, dice),
    }
}

//! The generator's search: draw, fill, rotate, check, and repeat.

use super::brick::{Brick, joints, placements};
use super::dice::Dice;
use super::sketch::sketch;
use super::tiling::{fill, mirror};
use super::{Style, growth, poles};
use crate::assembly::Assembly;
use crate::stance::{MIN_SUPPORT_MARGIN_U, support_margin_u};
use crate::strength::overloaded;
use crate::{Inventory, N_BLOCKS, Placement};

/// Maximum number of draws.
const MAX_DRAWS: usize = 20_000;
/// Number of valid structures among which the most appealing is chosen.
const N_CANDIDATES: usize = 3;
/// The same for record styles (longest and tallest).
const N_RECORD_CANDIDATES: usize = 8;
/// Draws after which the search moves to the next variant of a record.
const DRAWS_PER_IDEA: usize = 500;
/// Draws after which one valid structure is enough.
const PATIENCE: usize = 3_000;
/// Number of attempts to fill one sketch.
const N_FILLS: usize = 4;

/// A structure that passes the checks.
#[derive(Clone, Debug)]
pub(super) struct Found {
    pub(super) placements: Vec<Placement>,
    /// Description of the shape.
    pub(super) words: String,
    /// Visual interest; larger is better.
    appeal: i32,
}

/// The cost of a search.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Effort {
    /// Shapes drawn or grown.
    pub(super) n_draws: usize,
    /// Structures checked.
    pub(super) n_checked: usize,
    /// Structures that passed.
    pub(super) n_sound: usize,
}

impl Found {
    /// Returns the size along an axis in units.
    pub(super) fn extent(&self, axis: usize) -> i32 {
        let inventory = Inventory::standard();
        let along = || self.placements.iter().map(|p| (p.center_half_units[axis], p.size_cells(inventory)[axis]));
        let high = along().map(|(center, size)| center + size).max().unwrap_or(0);
        (high - along().map(|(center, size)| center - size).min().unwrap_or(0)) / 2
    }
}

/// Returns the most appealing of the first few valid structures; `None` if there was none.
pub(super) fn search(style: Style, n_blocks: usize, dice: &mut Dice) -> (Option<Found>, Effort) {
    let mut best: Option<Found> = None;
    let mut effort = Effort::default();
    let record = match style {
        Style::Longest => Some(0),
        Style::Tallest => Some(2),
        _ => None,
    };
    // Use one idea for all candidates, otherwise the most extreme idea would always win.
    let mut idea = dice.below(N_BLOCKS);
    let n_candidates = if record.is_some() { N_RECORD_CANDIDATES } else { N_CANDIDATES };
    while effort.n_draws < MAX_DRAWS && effort.n_sound < n_candidates {
        if effort.n_sound > 0 && effort.n_draws > PATIENCE {
            break;
        }
        effort.n_draws += 1;
        if effort.n_sound == 0 && effort.n_draws % DRAWS_PER_IDEA == 0 {
            idea += 1;
        }
        let found = match style {
            Style::Any => growth::grow(n_blocks, dice).and_then(|bricks| {
                effort.n_checked += 1;
                check_bricks(&bricks, "structure", dice)
            }),
            _ => drawn(style, n_blocks, idea, &mut effort, dice),
        };
        if let Some(mut found) = found {
            if let Some(axis) = record {
                // The record outweighs visual interest.
                found.appeal += 100 * found.extent(axis);
            }
            effort.n_sound += 1;
            if best.as_ref().is_none_or(|best| found.appeal > best.appeal) {
                best = Some(found);
            }
        }
    }
    (best, effort)
}

fn drawn(style: Style, n_blocks: usize, idea: usize, effort: &mut Effort, dice: &mut Dice) -> Option<Found> {
    let sketch = sketch(style, n_blocks, idea, dice)?;
    let planes: Vec<_> = [0, 1].into_iter().filter_map(|axis| mirror(&sketch.cells, axis)).collect();
    (0..N_FILLS).find_map(|attempt| {
        // For a symmetric shape, try symmetric fills first.
        let plane = if attempt + 1 < N_FILLS && !planes.is_empty() { Some(dice.pick(&planes)) } else { None };
        let bricks = fill(&sketch.cells, n_blocks, plane, dice)?;
        effort.n_checked += 1;
        check_bricks(&bricks, &sketch.words, dice)
    })
}

/// Rotates the bricks' magnets and returns the structure if it passes the checks.
fn check_bricks(bricks: &[Brick], words: &str, dice: &mut Dice) -> Option<Found> {
    let inventory = Inventory::standard();
    let joints = joints(bricks);
    // Cheap checks come first; the order does not change the result.
    let cells: Vec<_> = bricks.iter().map(Brick::cells).collect();
    let lowest = bricks.iter().map(|brick| brick.low[2]).min()?;
    let rotations = poles::turned(bricks, &joints, dice)?;
    let contacts: Vec<_> = joints.iter().map(|(_, joint)| joint.clone()).collect();
    if overloaded(&cells, &contacts, lowest).is_some() {
        return None;
    }
    let mut placements = placements(bricks, &rotations);
    let corner = |k: usize| bricks.iter().map(|brick| brick.low[k]).min().unwrap_or(0);
    for placement in &mut placements {
        placement.center_half_units = std::array::from_fn(|k| placement.center_half_units[k] - 2 * corner(k));
    }
    if support_margin_u(&placements, inventory) < MIN_SUPPORT_MARGIN_U || !assemblable(&placements) {
        return None;
    }
    let mut types: Vec<usize> = bricks.iter().map(|brick| brick.type_idx).collect();
    types.sort_unstable();
    types.dedup();
    let n_loops = joints.len() + 1 - bricks.len().min(joints.len() + 1);
    let appeal = 2 * types.len() as i32 + n_loops.min(bricks.len()) as i32;
    Some(Found { placements, words: words.to_owned(), appeal })
}

/// Returns whether the structure has an assembly order.
fn assemblable(placements: &[Placement]) -> bool {
    Assembly::is_possible(placements)
}

//! The generator's search: draw, fill, rotate, check, and repeat.

use super::brick::{Brick, joints, placements};
use super::dice::Dice;
use super::sketch::sketch;
use super::tiling::{fill, mirror};
use super::{Style, growth, poles};
use blueprints::assembly::Assembly;
use blueprints::placement::{extent_u, move_to_origin};
use blueprints::stance::{MIN_SUPPORT_MARGIN_U, support_margin_u};
use blueprints::strength::overloaded;
use blueprints::{N_BLOCKS, Placement};

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

/// Returns the most appealing of the first few valid structures, or the number of draws if there was none.
pub(super) fn search(style: Style, n_blocks: usize, dice: &mut Dice) -> Result<Found, usize> {
    let mut best: Option<Found> = None;
    let mut n_draws = 0;
    let mut n_sound = 0;
    let record = match style {
        Style::Longest => Some(0),
        Style::Tallest => Some(2),
        _ => None,
    };
    // Use one idea for all candidates, otherwise the most extreme idea would always win.
    let mut idea = dice.below(N_BLOCKS);
    let n_candidates = if record.is_some() { N_RECORD_CANDIDATES } else { N_CANDIDATES };
    while n_draws < MAX_DRAWS && n_sound < n_candidates {
        if n_sound > 0 && n_draws > PATIENCE {
            break;
        }
        n_draws += 1;
        if n_sound == 0 && n_draws % DRAWS_PER_IDEA == 0 {
            idea += 1;
        }
        let found = match style {
            Style::Any => growth::grow(n_blocks, dice).and_then(|bricks| check_bricks(&bricks, "structure", dice)),
            _ => drawn(style, n_blocks, idea, dice),
        };
        if let Some(mut found) = found {
            if let Some(axis) = record {
                // The record outweighs visual interest.
                found.appeal += 100 * extent_u(&found.placements)[axis];
            }
            n_sound += 1;
            if best.as_ref().is_none_or(|best| found.appeal > best.appeal) {
                best = Some(found);
            }
        }
    }
    best.ok_or(n_draws)
}

fn drawn(style: Style, n_blocks: usize, idea: usize, dice: &mut Dice) -> Option<Found> {
    let sketch = sketch(style, n_blocks, idea, dice)?;
    let planes: Vec<_> = [0, 1].into_iter().filter_map(|axis| mirror(&sketch.cells, axis)).collect();
    (0..N_FILLS).find_map(|attempt| {
        // For a symmetric shape, try symmetric fills first.
        let plane = if attempt + 1 < N_FILLS && !planes.is_empty() { Some(dice.pick(&planes)) } else { None };
        let bricks = fill(&sketch.cells, n_blocks, plane, dice)?;
        check_bricks(&bricks, &sketch.words, dice)
    })
}

/// Rotates the bricks' magnets and returns the structure if it passes the checks.
fn check_bricks(bricks: &[Brick], words: &str, dice: &mut Dice) -> Option<Found> {
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
    move_to_origin(&mut placements);
    if support_margin_u(&placements) < MIN_SUPPORT_MARGIN_U || !Assembly::is_possible(&placements) {
        return None;
    }
    let mut types: Vec<usize> = bricks.iter().map(|brick| brick.type_idx).collect();
    types.sort_unstable();
    types.dedup();
    let n_loops = joints.len() + 1 - bricks.len().min(joints.len() + 1);
    let appeal = 2 * types.len() as i32 + n_loops.min(bricks.len()) as i32;
    Some(Found { placements, words: words.to_owned(), appeal })
}

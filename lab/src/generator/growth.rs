//! Unconstrained growth: blocks are attached to magnets one at a time, with random preferences for each structure.

use super::brick::{Brick, Stock};
use super::dice::Dice;
use super::tiling::shapes;

/// Number of candidate places for each block.
const N_CANDIDATE_PLACES: usize = 20;

/// Random preferences of one structure.
struct Preferences {
    /// Weight of contact area.
    close: i32,
    /// Weight of height.
    upward: i32,
    /// Weight of block size.
    big: i32,
    /// Whether the structure is symmetric across x: blocks come in pairs or lie in the middle.
    mirrored: bool,
}

/// Grows `n_blocks` blocks from the ground; `None` if a block does not fit anywhere.
pub(super) fn grow(n_blocks: usize, dice: &mut Dice) -> Option<Vec<Brick>> {
    let preferences = Preferences {
        close: dice.between(1, 5),
        upward: dice.between(-1, 3),
        big: dice.between(0, 2),
        mirrored: dice.chance(70),
    };
    let mut stock = Stock::full();
    let &(type_idx, size) = &shapes()[dice.below(shapes().len())];
    let first = Brick { type_idx, low: [0, 0, 0], size };
    let plane = first.low[0] + first.high(0) - 1;
    stock.take(type_idx, 1);
    let mut bricks = vec![first];
    while bricks.len() < n_blocks {
        let mut best: Option<(i32, Vec<Brick>)> = None;
        for _ in 0..N_CANDIDATE_PLACES {
            let Some(brick) = candidate(&bricks, dice) else { continue };
            let image = brick.mirrored(0, plane);
            let group = if !preferences.mirrored || image == brick { vec![brick] } else { vec![brick, image] };
            let apart = group.len() == 1 || !brick.overlaps(&image);
            if !apart || bricks.len() + group.len() > n_blocks || stock.left(brick.type_idx) < group.len() {
                continue;
            }
            let score = score(&brick, &bricks, &preferences) + dice.between(0, 3);
            if best.as_ref().is_none_or(|(most, _)| score > *most) {
                best = Some((score, group));
            }
        }
        let (_, group) = best?;
        stock.take(group[0].type_idx, group.len());
        bricks.extend(group);
    }
    Some(bricks)
}

/// Draws a block on a face of another one; `None` if it is below the ground or overlaps.
fn candidate(bricks: &[Brick], dice: &mut Dice) -> Option<Brick> {
    let &(type_idx, size) = &shapes()[dice.below(shapes().len())];
    let anchor = bricks[dice.below(bricks.len())];
    let axis = dice.below(3);
    let low = std::array::from_fn(|k| {
        if k != axis {
            // Aligned edges look deliberate.
            match dice.below(4) {
                0 => anchor.low[k],
                1 => anchor.high(k) - size[k],
                _ => dice.between(anchor.low[k] - size[k] + 1, anchor.high(k) - 1),
            }
        } else if dice.chance(50) {
            anchor.high(k)
        } else {
            anchor.low[k] - size[k]
        }
    });
    let brick = Brick { type_idx, low, size };
    (low[2] >= 0 && bricks.iter().all(|other| !brick.overlaps(other))).then_some(brick)
}

fn score(brick: &Brick, bricks: &[Brick], preferences: &Preferences) -> i32 {
    let touching: Vec<usize> =
        bricks.iter().filter_map(|other| brick.contact(other)).map(|(_, places)| places.len()).collect();
    let n_neighbors = touching.len() as i32;
    let n_pairs = touching.iter().sum::<usize>() as i32;
    let top = bricks.iter().map(|other| other.high(2)).max().unwrap_or(0);
    let rise = (brick.high(2) - top).max(0);
    preferences.close * (2 * n_neighbors + n_pairs) / 2
        + 2 * preferences.upward * rise
        + preferences.big * brick.volume()
}

//! Rotations that make the poles that meet attract, without moving a block.
//!
//! As in the generator, two blocks that touch along an axis attract exactly if the magnets on their +axis faces have
//! equal signs. So each piece, a set of blocks connected by contacts along that axis, shares one sign. A block that
//! keeps its rotation settles the signs of its pieces; any other piece has the sign of its first block. A block with
//! three different sides reaches only half of the combinations, and may have to change the sign of a piece that is not
//! settled yet.

use std::collections::BTreeMap;

use crate::pieces::pieces;
use crate::{CubeRotation, Inventory, Placement};

/// Number of combinations of three signs. A block with two equal sides reaches all of them.
const N_COMBINATIONS: usize = 8;

/// Returns a rotation for every block; those that are not free keep theirs.
pub(super) fn matching(placements: &[Placement], is_free: &[bool]) -> Vec<CubeRotation> {
    let inventory = Inventory::standard();
    let mut turns: Vec<CubeRotation> = placements.iter().map(|p| p.rotation).collect();
    let pieces = pieces_by_axis(placements);
    let mut signs = [0, 1, 2].map(|k| turns.iter().map(|turn| turn.signs()[k]).collect::<Vec<i32>>());
    let mut settled = [(); 3].map(|()| vec![false; placements.len()]);
    // Iterate backward, so that the first of two conflicting blocks wins.
    for i in (0..placements.len()).rev().filter(|&i| !is_free[i]) {
        for k in 0..3 {
            signs[k][pieces[k][i]] = turns[i].signs()[k];
            settled[k][pieces[k][i]] = true;
        }
    }
    let choices = |i: usize| -> Vec<CubeRotation> {
        let size = |turn: CubeRotation| turn.apply(inventory.cells(placements[i].block).map(i32::from)).map(i32::abs);
        CubeRotation::all().filter(|turn| size(*turn) == size(placements[i].rotation)).collect()
    };
    let free = (0..placements.len()).filter(|&i| is_free[i]).map(|i| (i, choices(i)));
    // Blocks that cannot have all combinations of signs come first.
    let (few, all): (Vec<_>, Vec<_>) = free.partition(|(_, choices)| choices.len() < N_COMBINATIONS);
    for (i, choices) in few.into_iter().chain(all) {
        let own: [usize; 3] = std::array::from_fn(|k| pieces[k][i]);
        let cost = |turn: &CubeRotation| {
            let differing = || (0..3).filter(|&k| turn.signs()[k] != signs[k][own[k]]);
            let n_clashes = differing().filter(|&k| settled[k][own[k]]).count();
            (n_clashes, differing().count(), *turn != placements[i].rotation)
        };
        let Some(turn) = choices.iter().copied().min_by_key(cost) else { continue };
        turns[i] = turn;
        for k in (0..3).filter(|_| choices.len() < N_COMBINATIONS) {
            if !settled[k][own[k]] {
                signs[k][own[k]] = turn.signs()[k];
                settled[k][own[k]] = true;
            }
        }
    }
    turns
}

/// Returns, for each axis and block, the first block of its piece.
fn pieces_by_axis(placements: &[Placement]) -> [Vec<usize>; 3] {
    let cells = placements.iter().enumerate();
    let cells = cells.flat_map(|(i, p)| p.filled_cells().into_iter().map(move |cell| (cell, i)));
    let filled: BTreeMap<[i32; 3], usize> = cells.collect();
    [0, 1, 2].map(|axis| {
        let contacts = filled.iter().filter_map(|(cell, &a)| {
            let mut next = *cell;
            next[axis] += 1;
            Some((a, *filled.get(&next)?))
        });
        pieces(placements.len(), contacts)
    })
}

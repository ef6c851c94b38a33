//! Finds what a file leaves open: which way blocks lie, and how they are turned.
//!
//! A block's `at` is its lowest corner, so what is open are the sides that lie along the drawing's axes: one to six ways.
//! Ways of all blocks are searched for together, with no overlap, and those with the most magnets that meet come first.
//!
//! Given the ways, turns follow from equations. Let `s_k` be the sign of the magnets on the face that points along +k in the
//! drawing; the opposite face has the other sign. Two blocks that touch along axis k attract exactly if their `s_k` are
//! equal, and the product of a block's three signs is the determinant of the permutation of its axes. A block with two equal
//! sides can swap them and reaches all eight combinations; for one with three different sides this is an equation.

mod poles;

use std::collections::BTreeSet;

use crate::error::BlueprintError;
use crate::format::Draft;
use crate::stance::{MIN_SUPPORT_MARGIN_U, stance};
use crate::{BlockIdx, CubeRotation, Inventory};
use poles::Parities;

/// Most partial drawings that are followed from one block to the next, so that time and memory are bounded. The ones with
/// the most magnets that meet stay.
const MAX_FOLLOWED: usize = 1024;

/// Most drawings that are handed on to the checks that take long.
const MAX_TRIED: usize = 16;

type Cell = [i32; 3];

/// A way to complete a drawing: a turn for each block.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Completed {
    pub(crate) turns: Vec<CubeRotation>,
    /// For each block whose turn was open, how it was found.
    pub(crate) found: Vec<Option<FoundTurn>>,
}

/// How a block's turn was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FoundTurn {
    /// Cells that the block fills along the drawing's axes.
    pub size: [i32; 3],
    /// In how many ways it lies in the drawings that hold together and stand, 1 if there is only this one.
    pub n_ways: usize,
    /// Whether the search was cut off, so that there may be more ways.
    pub may_be_more: bool,
    /// Whether its neighbors' poles leave only this turn.
    pub is_only: bool,
}

/// Completions of a draft whose blocks are assigned, best first: those that hang together and stand, or else one that does
/// not, for the checks to say what is wrong with it.
pub(crate) fn completions(
    draft: &Draft,
    assigned: &[BlockIdx],
    inventory: &Inventory,
) -> Result<Vec<Completed>, BlueprintError> {
    let search = Search::new(draft, assigned, inventory)?;
    let turns: Option<Vec<CubeRotation>> = draft.blocks.iter().map(|block| block.turn).collect();
    if let Some(turns) = turns {
        return Ok(vec![Completed { found: vec![None; turns.len()], turns }]);
    }
    let (drawings, is_cut) = search.drawings()?;
    let mut good = Vec::new();
    let mut first = None;
    for sizes in drawings {
        let drawing = search.turned(sizes);
        let stands = drawing.fits && {
            let placements = draft.place(assigned, &drawing.turns, inventory);
            stance(&placements, inventory).margin_u >= MIN_SUPPORT_MARGIN_U
        };
        if stands {
            good.push(drawing);
        } else if first.is_none() {
            first = Some(drawing);
        }
    }
    if good.is_empty() {
        good.extend(first);
    }
    let ways = |i: usize| good.iter().map(|drawing| drawing.sizes[i]).collect::<BTreeSet<Cell>>().len();
    let n_ways: Vec<usize> = (0..assigned.len()).map(ways).collect();
    let complete = |Drawing { sizes, turns, is_only, .. }: Drawing| {
        let found = |i: usize| FoundTurn {
            size: sizes[i],
            n_ways: n_ways[i],
            may_be_more: is_cut,
            is_only: is_only[i] && n_ways[i] == 1,
        };
        let found = (0..sizes.len()).map(|i| draft.blocks[i].turn.is_none().then(|| found(i))).collect();
        Completed { turns, found }
    };
    Ok(good.into_iter().take(MAX_TRIED).map(complete).collect())
}

/// A way for every block to lie and to be turned.
struct Drawing {
    sizes: Vec<Cell>,
    turns: Vec<CubeRotation>,
    /// For each block, whether the poles leave this turn only.
    is_only: Vec<bool>,
    /// Whether all hang together and attract.
    fits: bool,
}

/// A draft and what each of its blocks can fill.
struct Search<'a> {
    draft: &'a Draft,
    /// Sides of each block along its own axes.
    own: Vec<Cell>,
    /// Cells that each block may fill along the drawing's axes.
    options: Vec<Vec<Cell>>,
}

impl<'a> Search<'a> {
    fn new(draft: &'a Draft, assigned: &[BlockIdx], inventory: &Inventory) -> Result<Self, BlueprintError> {
        let own: Vec<Cell> = assigned.iter().map(|&idx| inventory.cells(idx).map(i32::from)).collect();
        let mut options = Vec::with_capacity(own.len());
        for ((block, &own), &idx) in draft.blocks.iter().zip(&own).zip(assigned) {
            let of = |turn: CubeRotation| turn.apply(own).map(i32::abs);
            // In the order of the turns, so that a block lies along x where nothing else decides.
            let mut all: Vec<Cell> = Vec::new();
            for size in CubeRotation::all().map(of) {
                if !all.contains(&size) {
                    all.push(size);
                }
            }
            let name = || block.name.clone();
            options.push(match (block.turn.map(of), block.size) {
                (Some(turned), Some(size)) if turned != size => {
                    return Err(BlueprintError::SizeAndAxes { block: name(), turned, size });
                }
                (Some(turned), _) => vec![turned],
                (None, Some(size)) if all.contains(&size) => vec![size],
                (None, Some(size)) => {
                    let (type_name, cells) = (block.type_name.clone(), inventory.cells(idx));
                    return Err(BlueprintError::BadSize { block: name(), type_name, size, cells });
                }
                (None, None) => all,
            });
        }
        Ok(Self { draft, own, options })
    }

    /// Sizes of all blocks without an overlap, those with the most magnets that meet first, and whether some were dropped.
    fn drawings(&self) -> Result<(Vec<Vec<Cell>>, bool), BlueprintError> {
        // Blocks that can lie in one way only come first: the others have to make room for them.
        let mut order: Vec<usize> = (0..self.own.len()).collect();
        order.sort_by_key(|&i| (self.options[i].len(), self.draft.blocks[i].at[2], i));
        // By position in `order`; each with the number of magnet pairs.
        let mut followed: Vec<(usize, Vec<Cell>)> = vec![(0, Vec::new())];
        let mut is_cut = false;
        for (n_placed, &i) in order.iter().enumerate() {
            let mut next = Vec::new();
            for (n_pairs, sizes) in &followed {
                for &size in &self.options[i] {
                    let placed = order[..n_placed].iter().zip(sizes);
                    let met: Option<usize> = placed.map(|(&j, &other)| self.n_pairs(i, size, j, other)).sum();
                    if let Some(met) = met {
                        next.push((n_pairs + met, [&sizes[..], &[size]].concat()));
                    }
                }
            }
            if next.is_empty() {
                return self.overlapping(i).map(|sizes| (vec![sizes], is_cut));
            }
            // Stable, so that equal ones keep the order of their ways.
            next.sort_by_key(|(n_pairs, _)| std::cmp::Reverse(*n_pairs));
            is_cut |= next.len() > MAX_FOLLOWED;
            next.truncate(MAX_FOLLOWED);
            followed = next;
        }
        let in_file_order = |sizes: Vec<Cell>| {
            let mut sorted: Vec<_> = order.iter().zip(sizes).collect();
            sorted.sort_by_key(|(i, _)| **i);
            sorted.into_iter().map(|(_, size)| size).collect()
        };
        Ok((followed.into_iter().map(|(_, sizes)| in_file_order(sizes)).collect(), is_cut))
    }

    /// What to say of block `i`, for which there was no room: sizes for the checks to judge if it can lie in one way only.
    fn overlapping(&self, i: usize) -> Result<Vec<Cell>, BlueprintError> {
        let block = &self.draft.blocks[i];
        if self.options[i].len() > 1 {
            let (block, type_name, at) = (block.name.clone(), block.type_name.clone(), block.at);
            return Err(BlueprintError::NoRoom { block, type_name, at });
        }
        Ok(self.options.iter().map(|options| options[0]).collect())
    }

    /// Number of magnet pairs of two blocks that touch, 0 of two that do not, `None` if they overlap.
    fn n_pairs(&self, i: usize, size: Cell, j: usize, other: Cell) -> Option<usize> {
        match self.contact(i, size, j, other) {
            Contact::Overlap => None,
            Contact::Apart => Some(0),
            Contact::Along { n_pairs, .. } => Some(n_pairs),
        }
    }

    fn contact(&self, i: usize, size: Cell, j: usize, other: Cell) -> Contact {
        let (a, b) = (self.draft.blocks[i].at, self.draft.blocks[j].at);
        // How far the two reach into each other along each axis: 0 where they touch, less where they are apart.
        let depth: Cell = std::array::from_fn(|k| (a[k] + size[k]).min(b[k] + other[k]) - a[k].max(b[k]));
        if depth.iter().all(|&d| d > 0) {
            return Contact::Overlap;
        }
        let touching = (0..3).find(|&k| depth[k] == 0 && (0..3).all(|l| l == k || depth[l] > 0));
        touching.map_or(Contact::Apart, |axis| {
            let area: i32 = (0..3).filter(|&k| k != axis).map(|k| depth[k]).product();
            Contact::Along { axis, n_pairs: usize::try_from(area).unwrap_or(0) }
        })
    }

    /// A turn for each block.
    fn turned(&self, sizes: Vec<Cell>) -> Drawing {
        let n = sizes.len();
        // An unknown for each block and axis: whether s_k is negative. z comes first, so that x and y follow from it.
        let unknown = |i: usize, axis: usize| 1_u64 << ((2 - axis) * crate::N_BLOCKS + i);
        let mut parities = Parities::new();
        let mut fits = true;
        for (i, block) in self.draft.blocks.iter().enumerate() {
            if let Some(turn) = block.turn {
                for axis in 0..3 {
                    fits &= parities.add(unknown(i, axis), sign(turn, axis) < 0);
                }
            } else if let Some(is_odd) = parity(self.own[i], sizes[i]) {
                fits &= parities.add((0..3).map(|axis| unknown(i, axis)).sum(), is_odd);
            }
        }
        let mut piece: Vec<usize> = (0..n).collect();
        for i in 0..n {
            for j in 0..i {
                if let Contact::Along { axis, .. } = self.contact(i, sizes[i], j, sizes[j]) {
                    fits &= parities.add(unknown(i, axis) | unknown(j, axis), false);
                    let (low, high) = (piece[i].min(piece[j]), piece[i].max(piece[j]));
                    piece.iter_mut().filter(|p| **p == high).for_each(|p| *p = low);
                }
            }
        }
        fits &= piece.iter().all(|&p| p == 0);
        let forced = parities.clone();
        for i in (0..n).filter(|&i| self.draft.blocks[i].turn.is_none()) {
            // If that can be had, the block's own z points up, as people draw blocks and as they lie around.
            let (own, size) = (self.own[i], sizes[i]);
            if own[2] == size[2] && own[0] != own[1] && parities.add(unknown(i, 2), false) {
                parities.add(unknown(i, 0) | unknown(i, 1), size[0] != own[0]);
            }
        }
        let solved = parities.solution();
        let sign_of = |i: usize, axis: usize| if solved & unknown(i, axis) == 0 { 1 } else { -1 };
        let turn = |i: usize| {
            let can_be = |turn: &CubeRotation| {
                turn.apply(self.own[i]).map(i32::abs) == sizes[i]
                    && (0..3).all(|axis| sign(*turn, axis) == sign_of(i, axis))
            };
            let is_upright = |turn: &CubeRotation| turn.matrix()[2][2] == 1;
            let fitting = || CubeRotation::all().filter(can_be);
            // Only where the equations contradict each other is there none.
            let found = self.draft.blocks[i].turn.or_else(|| fitting().find(is_upright)).or_else(|| fitting().next());
            found.unwrap_or_else(|| {
                let of_size = |turn: &CubeRotation| turn.apply(self.own[i]).map(i32::abs) == sizes[i];
                CubeRotation::all().find(of_size).unwrap_or(CubeRotation::IDENTITY)
            })
        };
        let is_cube = |i: usize| self.own[i].iter().all(|&side| side == self.own[i][0]);
        let is_only = |i: usize| !is_cube(i) && (0..3).all(|axis| forced.determine(unknown(i, axis)));
        let (turns, is_only) = ((0..n).map(turn).collect(), (0..n).map(is_only).collect());
        Drawing { sizes, turns, is_only, fits }
    }
}

/// How two blocks lie to each other.
enum Contact {
    Overlap,
    Apart,
    Along { axis: usize, n_pairs: usize },
}

/// Sign of the magnets on the face that points along `axis` in the drawing.
fn sign(turn: CubeRotation, axis: usize) -> i32 {
    turn.matrix()[axis].iter().sum()
}

/// Whether a block with three different sides lies in an odd permutation of its axes; `None` for one with equal sides.
fn parity(own: Cell, size: Cell) -> Option<bool> {
    let is_distinct = own[0] != own[1] && own[1] != own[2] && own[0] != own[2];
    // The three cyclic permutations are the even ones.
    is_distinct.then(|| !(0..3).any(|by| (0..3).all(|k| size[k] == own[(k + by) % 3])))
}

#[cfg(test)]
mod tests;

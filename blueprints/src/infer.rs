//! Infers what a file leaves open: which way blocks lie, and how they are rotated.
//!
//! A block's `at` is its lowest corner, so only the assignment of its sides to the drawing's axes is open: one to six
//! ways. The search covers the ways of all blocks together, without overlap, and ranks those with the most magnets that
//! meet first.
//!
//! Given the ways, the rotations follow from equations. Let `s_k` be the sign of the magnets on the face that points
//! along +k in the drawing; the opposite face has the other sign. Two blocks that touch along axis k attract exactly if
//! their `s_k` are equal, and the product of a block's three signs is the determinant of the permutation of its axes. A
//! block with two equal sides can swap them and reaches all eight combinations; for a block with three different sides,
//! this is an equation.

mod poles;

use std::collections::BTreeSet;
use std::fmt;

use crate::error::BlueprintError;
use crate::format::Draft;
use crate::lattice::is_odd;
use crate::pieces::pieces;
use crate::stance::{MIN_SUPPORT_MARGIN_U, support_margin_u};
use crate::{BlockIdx, CubeRotation, Inventory, Placement};
use poles::Parities;

/// Maximum number of partial drawings kept from one block to the next, which bounds time and memory. Those with the
/// most magnets that meet stay.
const MAX_FOLLOWED: usize = 1024;

/// Maximum number of drawings passed on to the slow checks.
const MAX_TRIED: usize = 16;

type Cell = [i32; 3];

/// A way to complete a drawing: a rotation for each block.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Completed {
    pub(crate) turns: Vec<CubeRotation>,
    /// How each block's rotation was found; `None` if the file gives it.
    pub(crate) found: Vec<Option<FoundTurn>>,
}

/// How a block's rotation was found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FoundTurn {
    /// Cells that the block fills along the drawing's axes.
    pub size: [i32; 3],
    /// Number of ways that the block lies in the drawings that hold together, whether they stand or not; at least 1. If
    /// no drawing holds together, all drawings without overlap count.
    pub n_ways: usize,
    /// Whether the search was cut off, so that there may be more ways.
    pub may_be_more: bool,
    /// Whether the neighbors' poles leave only this rotation.
    pub is_only: bool,
}

impl FoundTurn {
    /// Returns whether this is one of several possibilities.
    pub fn is_a_choice(&self) -> bool {
        self.n_ways > 1 || self.may_be_more
    }
}

impl fmt::Display for FoundTurn {
    /// Formats the text that follows "block … is turned …".
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { size, n_ways, .. } = self;
        let least = if self.may_be_more { "at least " } else { "" };
        if *size == [1, 1, 1] {
            // A cube can lie only one way, whatever its neighbors.
        } else if self.is_a_choice() {
            write!(f, ": of {least}{n_ways} ways it fills {size:?} cells, ")?;
            f.write_str("chosen by the checks and then by the most magnets that meet")?;
        } else {
            write!(f, ": it can fill {size:?} cells only")?;
        }
        f.write_str(if self.is_only { ", and its neighbors' poles leave no other turn" } else { "" })
    }
}

/// Returns completions of a draft with assigned blocks, best first: those that hold together and stand, or else one
/// that does not, so that the checks can report what is wrong with it.
pub(crate) fn completions(draft: &Draft, assigned: &[BlockIdx]) -> Result<Vec<Completed>, BlueprintError> {
    let search = Search::new(draft, assigned)?;
    let turns: Option<Vec<CubeRotation>> = draft.blocks.iter().map(|block| block.turn).collect();
    if let Some(turns) = turns {
        return Ok(vec![Completed { found: vec![None; turns.len()], turns }]);
    }
    let (drawings, may_be_more) = search.drawings()?;
    let mut drawings: Vec<Drawing> = drawings.into_iter().map(|sizes| search.turned(sizes)).collect();
    let holds_together = drawings.iter().any(|drawing| drawing.fits);
    drawings.retain(|drawing| drawing.fits == holds_together);
    let stands = |drawing: &Drawing| {
        let placements = draft.place(assigned, &drawing.turns);
        support_margin_u(&placements) >= MIN_SUPPORT_MARGIN_U
    };
    let n_ways = |i: usize| drawings.iter().map(|drawing| drawing.sizes[i]).collect::<BTreeSet<Cell>>().len();
    let n_ways: Vec<usize> = (0..assigned.len()).map(n_ways).collect();
    let good = drawings.iter().filter(|drawing| holds_together && stands(drawing));
    let mut taken: Vec<&Drawing> = good.take(MAX_TRIED).collect();
    if taken.is_empty() {
        // Take the one with the most magnets.
        taken.extend(drawings.first());
    }
    let complete = |drawing: &Drawing| {
        let found = |i: usize| FoundTurn {
            size: drawing.sizes[i],
            n_ways: n_ways[i],
            may_be_more,
            is_only: drawing.is_only[i] && n_ways[i] == 1,
        };
        let open = |i: usize| draft.blocks[i].turn.is_none().then(|| found(i));
        Completed { turns: drawing.turns.clone(), found: (0..assigned.len()).map(open).collect() }
    };
    Ok(taken.into_iter().map(complete).collect())
}

/// Returns a rotation for each block that fills the same cells as its placement, so that the poles that meet attract as
/// far as possible. The draft's axes are those of the placements.
pub(crate) fn turns(draft: &Draft, placements: &[Placement]) -> Result<Vec<CubeRotation>, BlueprintError> {
    let assigned: Vec<BlockIdx> = placements.iter().map(|placement| placement.block).collect();
    let sizes = placements.iter().map(Placement::size_cells).collect();
    Ok(Search::new(draft, &assigned)?.turned(sizes).turns)
}

/// A way and a rotation for every block.
struct Drawing {
    sizes: Vec<Cell>,
    turns: Vec<CubeRotation>,
    /// For each block, whether the poles leave only this rotation.
    is_only: Vec<bool>,
    /// Whether all blocks hold together and attract.
    fits: bool,
}

/// A draft and the cells that each of its blocks can fill.
struct Search<'a> {
    draft: &'a Draft,
    /// Sides of each block along its own axes.
    own: Vec<Cell>,
    /// Cells that each block may fill along the drawing's axes.
    options: Vec<Vec<Cell>>,
}

impl<'a> Search<'a> {
    fn new(draft: &'a Draft, assigned: &[BlockIdx]) -> Result<Self, BlueprintError> {
        let inventory = Inventory::standard();
        let own: Vec<Cell> = assigned.iter().map(|&idx| inventory.cells(idx).map(i32::from)).collect();
        let mut options = Vec::with_capacity(own.len());
        for ((block, &own), &idx) in draft.blocks.iter().zip(&own).zip(assigned) {
            let of = |turn: CubeRotation| turn.apply(own).map(i32::abs);
            // Keep the order of the rotations, so that a block lies along x if nothing else decides.
            let mut all: Vec<Cell> = Vec::new();
            for size in CubeRotation::all().map(of) {
                if !all.contains(&size) {
                    all.push(size);
                }
            }
            let name = &block.name;
            options.push(match (block.turn.map(of), block.size) {
                (Some(turned), Some(size)) if turned != size => {
                    return Err(BlueprintError::Invalid(format!(
                        "block {name:?}: turned by its axes it fills {turned:?} cells, its size is {size:?}; leave one of \
                         them out"
                    )));
                }
                (Some(turned), _) => vec![turned],
                (None, Some(size)) if all.contains(&size) => vec![size],
                (None, Some(size)) => {
                    let (type_name, cells) = (&block.type_name, inventory.cells(idx));
                    return Err(BlueprintError::Invalid(format!(
                        "block {name:?}: a block of type {type_name} cannot fill {size:?} cells; its sides are {cells:?} \
                         in some order"
                    )));
                }
                (None, None) => all,
            });
        }
        Ok(Self { draft, own, options })
    }

    /// Returns sizes of all blocks without overlap, those with the most magnets that meet first, and whether any were
    /// dropped.
    fn drawings(&self) -> Result<(Vec<Vec<Cell>>, bool), BlueprintError> {
        // Blocks that can lie only one way come first, because the others have to make room for them.
        let mut order: Vec<usize> = (0..self.own.len()).collect();
        order.sort_by_key(|&i| (self.options[i].len(), self.draft.blocks[i].at[2], i));
        // Sizes by position in `order`, with their number of magnet pairs.
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
            // The sort is stable, so that ties keep the order of their ways.
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

    /// Handles block `i`, for which there was no room. If it can lie only one way, returns sizes that the checks
    /// reject; otherwise, returns an error.
    fn overlapping(&self, i: usize) -> Result<Vec<Cell>, BlueprintError> {
        let block = &self.draft.blocks[i];
        if self.options[i].len() > 1 {
            let (name, type_name, at) = (&block.name, &block.type_name, block.at);
            return Err(BlueprintError::Invalid(format!(
                "block {name:?} of type {type_name} at {at:?} overlaps another block whichever way it lies; `at` is the \
                 lowest-numbered corner cell"
            )));
        }
        Ok(self.options.iter().map(|options| options[0]).collect())
    }

    /// Returns the number of magnet pairs of two blocks: 0 if they do not touch, `None` if they overlap.
    fn n_pairs(&self, i: usize, size: Cell, j: usize, other: Cell) -> Option<usize> {
        match self.contact(i, size, j, other) {
            Contact::Overlap => None,
            Contact::Apart => Some(0),
            Contact::Along { n_pairs, .. } => Some(n_pairs),
        }
    }

    fn contact(&self, i: usize, size: Cell, j: usize, other: Cell) -> Contact {
        let (a, b) = (self.draft.blocks[i].at, self.draft.blocks[j].at);
        // Overlap of the two along each axis: 0 where they touch, negative where they are apart.
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

    /// Computes a rotation for each block.
    fn turned(&self, sizes: Vec<Cell>) -> Drawing {
        let n = sizes.len();
        // There is one unknown per block and axis: whether s_k is negative. z comes first, so that x and y follow from
        // it.
        let unknown = |i: usize, axis: usize| 1_u64 << ((2 - axis) * crate::N_BLOCKS + i);
        let mut parities = Parities::new();
        let mut fits = true;
        for (i, block) in self.draft.blocks.iter().enumerate() {
            if let Some(turn) = block.turn {
                for axis in 0..3 {
                    fits &= parities.add(unknown(i, axis), turn.signs()[axis] < 0);
                }
            } else if let Some(is_odd) = is_odd(self.own[i], sizes[i]) {
                fits &= parities.add((0..3).map(|axis| unknown(i, axis)).sum(), is_odd);
            }
        }
        let mut touching = Vec::new();
        for i in 0..n {
            for j in 0..i {
                if let Contact::Along { axis, .. } = self.contact(i, sizes[i], j, sizes[j]) {
                    fits &= parities.add(unknown(i, axis) | unknown(j, axis), false);
                    touching.push((i, j));
                }
            }
        }
        fits &= pieces(n, touching).iter().all(|&piece| piece == 0);
        let forced = parities.clone();
        for i in (0..n).filter(|&i| self.draft.blocks[i].turn.is_none()) {
            // If possible, point the block's own z up, as people draw blocks and as they lie around.
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
                    && (0..3).all(|axis| turn.signs()[axis] == sign_of(i, axis))
            };
            let is_upright = |turn: &CubeRotation| turn.matrix()[2][2] == 1;
            let fitting = || CubeRotation::all().filter(can_be);
            // There is none only if the equations contradict each other.
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

/// How two blocks lie relative to each other.
enum Contact {
    Overlap,
    Apart,
    Along { axis: usize, n_pairs: usize },
}

#[cfg(test)]
mod tests;

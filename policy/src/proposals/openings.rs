//! The direction in which one piece of a structure leaves another.

use std::cell::RefCell;
use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};

use blueprints::hash::fnv1a;

/// A unit cell, by its lowest corner, in units (0.1 m).
pub(super) type Cell = [i32; 3];

/// Pairs of pieces that a thread remembers before it begins anew. An episode meets a few dozen, and a search takes up to
/// a millisecond.
const REMEMBERED: usize = 8192;

thread_local! {
    static KNOWN: RefCell<BTreeMap<[u64; 2], Option<Cell>>> = const { RefCell::new(BTreeMap::new()) };
}

/// Returns the direction, with entries −1, 0, and 1, in which piece `a` leaves piece `b` without touching it and which
/// opens all their common faces best; `None` if every direction is blocked. A direction that passes beside no block of
/// `b`, whose magnets would catch `a`, comes before all that do.
///
/// Of two directions, the better one has the larger least component along the normals of the common faces, then the
/// larger sum of them; of equal ones, the shorter. The cells of each piece are in the frame of the blueprint.
pub(super) fn opening(a: &Shape, b: &Shape) -> Option<Cell> {
    KNOWN.with_borrow_mut(|known| {
        if known.len() == REMEMBERED {
            known.clear();
        }
        *known.entry([a.key, b.key]).or_insert_with(|| search(&a.cells, &b.cells))
    })
}

/// The cells of a piece.
pub(super) struct Shape {
    cells: Vec<Cell>,
    /// A hash of the cells in their order, which is that of the blocks.
    key: u64,
}

impl Shape {
    pub(super) fn new(cells: Vec<Cell>) -> Self {
        let key = fnv1a(cells.iter().flatten().flat_map(|x| x.to_le_bytes()));
        Self { cells, key }
    }
}

/// A set of cells.
struct Grid {
    low: Cell,
    size: Cell,
    filled: Vec<bool>,
}

impl Grid {
    fn new(cells: &[Cell]) -> Self {
        let bound = |k: usize, of: fn(i32, i32) -> i32| cells.iter().map(|cell| cell[k]).reduce(of).unwrap_or(0);
        let low: Cell = std::array::from_fn(|k| bound(k, i32::min));
        let size: Cell = std::array::from_fn(|k| bound(k, i32::max) - low[k] + 1);
        let mut grid = Self { low, size, filled: vec![false; size.iter().product::<i32>() as usize] };
        for cell in cells {
            if let Some(index) = grid.index(cell) {
                grid.filled[index] = true;
            }
        }
        grid
    }

    fn contains(&self, cell: &Cell) -> bool {
        self.index(cell).is_some_and(|index| self.filled[index])
    }

    fn index(&self, cell: &Cell) -> Option<usize> {
        let [x, y, z] = std::array::from_fn(|k| cell[k] - self.low[k]);
        let is_inside = [x, y, z].iter().zip(self.size).all(|(x, size)| (0..size).contains(x));
        is_inside.then_some(((x * self.size[1] + y) * self.size[2] + z) as usize)
    }
}

fn search(a: &[Cell], b: &[Cell]) -> Option<Cell> {
    let other = Grid::new(b);
    let normals: BTreeSet<Cell> = a
        .iter()
        .flat_map(|cell| faces().map(move |normal| (cell, normal)))
        // The normal of a common face points from b to a.
        .filter(|(cell, normal)| other.contains(&std::array::from_fn(|k| cell[k] - normal[k])))
        .map(|(_, normal)| normal)
        .collect();
    let score = |direction: Cell| {
        let length = (dot(direction, direction) as f32).sqrt();
        let along = || normals.iter().map(|&normal| dot(normal, direction));
        let least = along().min().unwrap_or(0);
        let sum = along().sum::<i32>();
        [least as f32 / length, sum as f32 / length, -length]
    };
    let mut scored: Vec<([f32; 3], Cell)> = directions().map(|direction| (score(direction), direction)).collect();
    scored.retain(|([least, ..], _)| *least >= 0.0);
    // Of equal scores, the first direction stays the first.
    scored.sort_by(|(a, _), (b, _)| b.iter().zip(a).map(|(b, a)| b.total_cmp(a)).fold(Ordering::Equal, Ordering::then));
    let mut free = scored.into_iter().filter(|&(_, way)| is_free(a, &other, way)).peekable();
    let ([most, ..], best) = *free.peek()?;
    // Along a common face, it would pass beside that.
    let opens = |least: f32| least > 0.0 || most == 0.0;
    free.find(|&([least, ..], way)| opens(least) && !grazes(a, &other, way)).map(|(_, way)| way).or(Some(best))
}

fn faces() -> impl Iterator<Item = Cell> {
    directions().filter(|&d| dot(d, d) == 1)
}

/// The 26 directions to the neighbors of a cell.
fn directions() -> impl Iterator<Item = Cell> {
    let steps = || -1..=1;
    steps().flat_map(move |x| steps().flat_map(move |y| steps().map(move |z| [x, y, z]))).filter(|&d| d != [0; 3])
}

/// Whether no cell of `a`, moving along `direction`, meets `other`.
fn is_free(a: &[Cell], other: &Grid, direction: Cell) -> bool {
    // Between two lattice places, a moving cell overlaps every cell of the box between them.
    let overlapped = || {
        let range = |k: usize| direction[k].min(0)..=direction[k].max(0);
        range(0).flat_map(move |x| range(1).flat_map(move |y| range(2).map(move |z| [x, y, z])))
    };
    let n = n_steps(a, other, direction);
    (0..n).all(|t| a.iter().all(|cell| overlapped().all(|shift| !other.contains(&moved(cell, direction, t, shift)))))
}

/// Whether a cell of `a`, moving along `direction`, comes to lie beside one of `other`, where magnets may catch it.
fn grazes(a: &[Cell], other: &Grid, direction: Cell) -> bool {
    let n = n_steps(a, other, direction);
    (1..=n).any(|t| a.iter().any(|cell| faces().any(|face| other.contains(&moved(cell, direction, t, face)))))
}

/// Returns the number of steps of one unit after which the last cell of `a` has passed `other`.
fn n_steps(a: &[Cell], other: &Grid, direction: Cell) -> i32 {
    let along = |k: usize| match direction[k] {
        1 => a.iter().map(|cell| other.low[k] + other.size[k] - cell[k]).max(),
        -1 => a.iter().map(|cell| cell[k] + 1 - other.low[k]).max(),
        _ => None,
    };
    (0..3).filter_map(along).min().unwrap_or(0)
}

/// Returns a cell after `n` steps, and then `shift`.
fn moved(cell: &Cell, direction: Cell, n: i32, shift: Cell) -> Cell {
    std::array::from_fn(|k| cell[k] + direction[k] * n + shift[k])
}

fn dot(a: Cell, b: Cell) -> i32 {
    (0..3).map(|k| a[k] * b[k]).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_on_another_leaves_upward() {
        assert_eq!(search(&[[0, 0, 1]], &[[0, 0, 0]]), Some([0, 0, 1]));
        assert_eq!(search(&[[0, 0, 0]], &[[0, 0, 1]]), Some([0, 0, -1]));
    }

    #[test]
    fn a_block_in_a_corner_leaves_diagonally() {
        // Neighbors below and on the left: straight up would graze the left one.
        assert_eq!(search(&[[1, 0, 1]], &[[1, 0, 0], [0, 0, 1]]), Some([1, 0, 1]));
    }

    #[test]
    fn a_block_keeps_away_from_what_it_would_pass() {
        // It hangs, and straight down it would come to lie beside another one.
        assert_eq!(search(&[[0, 0, 0]], &[[0, 0, 1], [1, 0, -1]]), Some([-1, 0, -1]));
        // In a shaft, there is no other way.
        assert_eq!(
            search(&[[0, 0, 0]], &[[0, 0, 1], [1, 0, -1], [-1, 0, -1], [0, 1, -1], [0, -1, -1]]),
            Some([0, 0, -1])
        );
    }

    #[test]
    fn a_block_in_a_slot_leaves_along_it() {
        assert_eq!(search(&[[0, 0, 1]], &[[-1, 0, 1], [1, 0, 1], [0, 0, 0]]), Some([0, 0, 1]));
        let cage: Vec<Cell> = faces().collect();
        assert_eq!(search(&[[0, 0, 0]], &cage), None);
    }

    #[test]
    fn pieces_that_do_not_touch_leave_by_the_shortest_free_way() {
        let found = search(&[[0, 0, 0]], &[[3, 0, 0]]);
        assert!(found.is_some_and(|d| dot(d, d) == 1 && d != [1, 0, 0]), "{found:?}");
    }
}

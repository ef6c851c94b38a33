//! Fills a shape with blocks: a random exact cover with a given number of pieces from the stock.

use std::collections::BTreeSet;

use super::brick::{Brick, Cell, Stock};
use super::dice::Dice;
use blueprints::Inventory;

/// Maximum number of pieces that a search places; many short searches find more than a few long ones.
const MAX_NODES: usize = 600;
/// Number of places tried for a broad block before the search.
const TRIES_PER_PLATE: usize = 24;

/// A plane that maps a shape onto itself: an axis, and the sum of a cell's and its image's coordinate along it.
pub(super) type Mirror = (usize, i32);

/// Returns the mirror plane across `axis`, if there is one.
pub(super) fn mirror(cells: &BTreeSet<Cell>, axis: usize) -> Option<Mirror> {
    let low = cells.iter().map(|cell| cell[axis]).min()?;
    let plane = low + cells.iter().map(|cell| cell[axis]).max()?;
    let image = |mut cell: Cell| {
        cell[axis] = plane - cell[axis];
        cell
    };
    cells.iter().all(|&cell| cells.contains(&image(cell))).then_some((axis, plane))
}

/// Returns `n_blocks` blocks that fill `cells` exactly, in mirrored pairs if there is a mirror.
///
/// `None` means that this search found no solution, not that none exists.
pub(super) fn fill(
    cells: &BTreeSet<Cell>,
    n_blocks: usize,
    mirror: Option<Mirror>,
    dice: &mut Dice,
) -> Option<Vec<Brick>> {
    // The piece at the first free cell has its lowest corner there for any order of the axes; each order gives a
    // different bond.
    let mut axes = [0, 1, 2];
    dice.shuffle(&mut axes);
    let mut order: Vec<Cell> = cells.iter().copied().collect();
    order.sort_by_key(|cell| axes.map(|k| cell[k]));
    let n_free = order.len() as i32;
    let grid = Grid::of(cells);
    let mut search = Search {
        order,
        grid,
        n_free,
        mirror,
        stock: Stock::full(),
        bricks: Vec::with_capacity(n_blocks),
        n_blocks,
        nodes: MAX_NODES,
    };
    if dice.chance(60) {
        search.place_plates(dice);
    }
    search.run(0, dice).then_some(search.bricks)
}

/// The free cells of a cuboid.
struct Grid {
    low: Cell,
    size: [i32; 3],
    free: Vec<bool>,
}

impl Grid {
    fn of(cells: &BTreeSet<Cell>) -> Self {
        let along = |k: usize| cells.iter().map(move |cell| cell[k]);
        let low: Cell = std::array::from_fn(|k| along(k).min().unwrap_or(0));
        let size: [i32; 3] = std::array::from_fn(|k| along(k).max().unwrap_or(0) - low[k] + 1);
        let mut grid = Self { low, size, free: vec![false; size.iter().product::<i32>() as usize] };
        for &cell in cells {
            let at = grid.at(cell);
            grid.free[at] = true;
        }
        grid
    }

    fn at(&self, cell: Cell) -> usize {
        let [x, y, z]: [i32; 3] = std::array::from_fn(|k| cell[k] - self.low[k]);
        ((x * self.size[1] + y) * self.size[2] + z) as usize
    }

    fn is_free(&self, brick: &Brick) -> bool {
        let inside = (0..3).all(|k| self.low[k] <= brick.low[k] && brick.high(k) <= self.low[k] + self.size[k]);
        inside && brick.all_cells(|cell| self.free[self.at(cell)])
    }

    fn set(&mut self, brick: &Brick, free: bool) {
        brick.all_cells(|cell| {
            let at = self.at(cell);
            self.free[at] = free;
            true
        });
    }
}

struct Search {
    order: Vec<Cell>,
    grid: Grid,
    /// Free cells.
    n_free: i32,
    mirror: Option<Mirror>,
    stock: Stock,
    bricks: Vec<Brick>,
    n_blocks: usize,
    nodes: usize,
}

impl Search {
    /// Places blocks that are broad along two axes before others take up their room, which is scarce in a thin shape.
    fn place_plates(&mut self, dice: &mut Dice) {
        for type_idx in (0..Inventory::standard().types().len()).rev() {
            let ways: Vec<[i32; 3]> = shapes().iter().filter(|(t, _)| *t == type_idx).map(|(_, size)| *size).collect();
            if ways[0].iter().filter(|&&n| n > 1).count() < 2 {
                continue;
            }
            for _ in 0..TRIES_PER_PLATE * self.stock.left(type_idx) {
                let brick = Brick { type_idx, low: dice.pick(&self.order), size: dice.pick(&ways) };
                if !self.grid.is_free(&brick) {
                    continue;
                }
                if let Some(group) = self.group(brick)
                    && group.len() <= self.stock.left(type_idx)
                    && group.len() + self.bricks.len() <= self.n_blocks
                {
                    self.place(&group, true);
                }
            }
        }
    }

    fn run(&mut self, from: usize, dice: &mut Dice) -> bool {
        let Some(first) = (from..self.order.len()).find(|&i| self.grid.free[self.grid.at(self.order[i])]) else {
            return self.bricks.len() == self.n_blocks;
        };
        let n_left = self.n_blocks - self.bricks.len();
        let (least, most) = self.stock.volume_range(n_left);
        if n_left == 0 || !(least..=most).contains(&self.n_free) || self.nodes == 0 {
            return false;
        }
        self.nodes -= 1;
        let mean = f64::from(self.n_free) / n_left as f64;
        for group in self.groups(first, mean, dice) {
            if group.len() > n_left {
                continue;
            }
            self.place(&group, true);
            if self.run(first, dice) {
                return true;
            }
            self.place(&group, false);
        }
        false
    }

    /// Returns the groups that can be placed at a cell, in random order with pieces of about the mean volume first.
    fn groups(&self, first: usize, mean: f64, dice: &mut Dice) -> Vec<Vec<Brick>> {
        let mut groups: Vec<(f64, Vec<Brick>)> = Vec::new();
        for &(type_idx, size) in shapes() {
            let brick = Brick { type_idx, low: self.order[first], size };
            if self.stock.left(type_idx) == 0 || !self.grid.is_free(&brick) {
                continue;
            }
            let Some(group) = self.group(brick) else { continue };
            if self.stock.left(type_idx) >= group.len() {
                let off = (f64::from(brick.volume()) - mean).abs();
                groups.push((off + 3.0 * dice.below(1000) as f64 / 1000.0, group));
            }
        }
        groups.sort_by(|a, b| a.0.total_cmp(&b.0));
        groups.into_iter().map(|(_, group)| group).collect()
    }

    /// Returns a brick and its image, or the brick alone if it is its own image; `None` if they partly overlap.
    fn group(&self, brick: Brick) -> Option<Vec<Brick>> {
        let Some((axis, plane)) = self.mirror else { return Some(vec![brick]) };
        let image = brick.mirrored(axis, plane);
        if image == brick { Some(vec![brick]) } else { (!image.overlaps(&brick)).then(|| vec![brick, image]) }
    }

    fn place(&mut self, group: &[Brick], placed: bool) {
        for brick in group {
            self.grid.set(brick, !placed);
            self.n_free += if placed { -brick.volume() } else { brick.volume() };
        }
        let type_idx = group[0].type_idx;
        if placed {
            self.stock.take(type_idx, group.len());
            self.bricks.extend(group);
        } else {
            self.stock.put_back(type_idx, group.len());
            self.bricks.truncate(self.bricks.len() - group.len());
        }
    }
}

/// Returns every type in every axis-aligned orientation.
pub(super) fn shapes() -> &'static [(usize, [i32; 3])] {
    static SHAPES: std::sync::LazyLock<Vec<(usize, [i32; 3])>> = std::sync::LazyLock::new(|| {
        let mut shapes = BTreeSet::new();
        for (type_idx, block_type) in Inventory::standard().types().iter().enumerate() {
            let own = block_type.cells.map(i32::from);
            shapes.extend(blueprints::CubeRotation::all().map(|r| (type_idx, r.apply(own).map(i32::abs))));
        }
        shapes.into_iter().collect()
    });
    &SHAPES
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cuboid(size: [i32; 3]) -> BTreeSet<Cell> {
        Brick { type_idx: 0, low: [0, 0, 0], size }.cells().into_iter().collect()
    }

    #[test]
    fn fill_covers_every_cell_once_with_the_requested_number_of_blocks() {
        let cells = cuboid([6, 1, 4]);
        let plane = mirror(&cells, 0);
        assert_eq!(plane, Some((0, 5)));
        let mut n_found = 0;
        for seed in 0..40 {
            for mirror in [None, plane] {
                let Some(bricks) = fill(&cells, 8, mirror, &mut Dice::new([seed; 32])) else { continue };
                n_found += 1;
                let filled: Vec<Cell> = bricks.iter().flat_map(Brick::cells).collect();
                assert_eq!((bricks.len(), filled.len()), (8, 24));
                assert_eq!(filled.into_iter().collect::<BTreeSet<_>>(), cells);
                if mirror.is_some() {
                    assert!(bricks.iter().all(|brick| bricks.contains(&brick.mirrored(0, 5))));
                }
            }
        }
        assert!(n_found > 60, "{n_found} of 80");
        assert_eq!(fill(&cuboid([3, 3, 1]), 1, None, &mut Dice::new([0; 32])), None);
    }
}

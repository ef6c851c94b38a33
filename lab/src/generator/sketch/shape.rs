//! A shape as cells.

use std::collections::BTreeSet;

use crate::generator::brick::{Brick, Cell};

/// A shape and its description.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::generator) struct Sketch {
    pub(in crate::generator) cells: BTreeSet<Cell>,
    pub(in crate::generator) words: String,
}

impl Sketch {
    pub(super) fn new(words: &str) -> Self {
        Self { cells: BTreeSet::new(), words: words.to_owned() }
    }

    /// Adds a cuboid; does nothing if a side is not positive.
    pub(super) fn add(&mut self, low: Cell, size: [i32; 3]) {
        self.cells.extend(Brick { type_idx: 0, low, size }.cells());
    }

    pub(super) fn extent(&self, axis: usize) -> i32 {
        let along = || self.cells.iter().map(|cell| cell[axis]);
        along().max().unwrap_or(0) - along().min().unwrap_or(0) + 1
    }

    /// Returns the sketch if it has exactly that volume, otherwise `None`.
    pub(super) fn of_volume(self, volume: i32) -> Option<Self> {
        (self.cells.len() as i32 == volume).then_some(self)
    }
}

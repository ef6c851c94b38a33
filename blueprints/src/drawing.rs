//! A drawing in progress: blocks on the lattice that may not form a valid blueprint yet, and the remaining problems.
//!
//! Each of the [`checks`](crate::checks) stops at its first error. An editor needs all errors at once, each with the
//! blocks that it concerns, and needs the blocks rotated so that the poles that meet attract.

mod turns;

use std::collections::{BTreeMap, BTreeSet};

use crate::checks::{Check, check_placements, check_text};
use crate::error::BlueprintError;
use crate::format::MAX_COORDINATE;
use crate::pieces::pieces;
use crate::placement::move_to_origin;
use crate::stance::{MIN_SUPPORT_MARGIN_U, support_margin_u};
use crate::writer::numbered;
pub use crate::writer::word;
use crate::{
    Assembly, BlockIdx, Blueprint, BlueprintId, CubeRotation, Inventory, N_BLOCKS, NoAssembly, Placement,
    RelativePlacement, Split,
};

/// Maximum number of characters in a title; the rest is cut off.
pub const MAX_TITLE: usize = 80;

/// Title of a drawing without one.
const UNTITLED: &str = "a drawing";

/// A block of a drawing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DrawnBlock {
    /// Name of its type in the inventory.
    pub type_name: String,
    /// The lowest-numbered corner cell that it fills.
    pub at: [i32; 3],
    /// Its rotation.
    pub rotation: CubeRotation,
    /// Whether the block may take any rotation that fills the same cells.
    pub is_free: bool,
}

/// Blocks on the lattice.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Drawing {
    /// A short description of the structure.
    pub title: String,
    /// The blocks; at most as many of each type as the inventory has.
    pub blocks: Vec<DrawnBlock>,
}

/// Something that keeps a drawing from being a blueprint.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// The check that fails.
    pub check: Check,
    /// Indices in the drawing of the blocks concerned; empty if the problem concerns all of them.
    pub blocks: Vec<usize>,
    /// One sentence without a period.
    pub text: String,
}

/// Two blocks of a drawing, by index, that hold each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Connection {
    /// The lower index.
    pub a: usize,
    /// The higher index.
    pub b: usize,
    /// Number of magnet pairs, at least 1.
    pub n_magnet_pairs: usize,
}

/// The results of examining a drawing.
#[derive(Clone, Debug)]
pub struct Findings {
    /// Every overlap, every pair of blocks that repel, and the blocks that are not connected. If there are none of
    /// these, the first failure of the other checks; a structure that is too weak may also lack an assembly order.
    pub problems: Vec<Problem>,
    /// The pairs of blocks that hold each other.
    pub connections: Vec<Connection>,
    /// The blueprint, with an id derived from its structure, if there are no problems and at least two blocks.
    pub blueprint: Option<Blueprint>,
}

impl DrawnBlock {
    /// Creates a block from its fields in a file; `axes` are the directions of the block's x and y axes, for example
    /// `+x +y`.
    ///
    /// # Errors
    /// If the type is unknown, the axes do not form a rotation, or the cell is out of range.
    pub fn new(type_name: &str, at: [i32; 3], axes: &str, is_free: bool) -> Result<Self, BlueprintError> {
        let block = || type_name.to_owned();
        let inventory = Inventory::standard();
        if inventory.blocks_of_type(type_name).is_empty() {
            let known = inventory.types().iter().map(|t| t.name.as_str()).collect::<Vec<_>>().join(", ");
            return Err(BlueprintError::UnknownType { block: block(), type_name: block(), known });
        }
        if at.iter().any(|x| !(-MAX_COORDINATE..=MAX_COORDINATE).contains(x)) {
            return Err(BlueprintError::OutOfRange { block: block(), at: at.map(i64::from) });
        }
        let rotation = CubeRotation::all().find(|rotation| rotation.axes() == axes);
        let rotation = rotation.ok_or_else(|| BlueprintError::BadAxes { block: block(), axes: axes.to_owned() })?;
        Ok(Self { type_name: block(), at, rotation, is_free })
    }
}

impl Drawing {
    /// Parses a blueprint file. The lowest corner of the drawing is at the origin.
    ///
    /// # Errors
    /// If the text is not a valid blueprint.
    pub fn from_toml(text: &str) -> Result<Self, BlueprintError> {
        let blueprint = check_text("drawing.toml", text).blueprint.map_err(|error| error.error)?;
        let block = |placement: &Placement| DrawnBlock {
            type_name: Inventory::standard().block_type(placement.block).name.clone(),
            at: placement.lowest_cell(),
            rotation: placement.rotation,
            is_free: false,
        };
        let blocks = blueprint.placements().iter().map(block).collect();
        Ok(Self { title: blueprint.title().to_owned(), blocks })
    }

    /// Rotates every free block, without changing the cells that it fills, so that as few like poles as possible meet.
    ///
    /// # Errors
    /// If the inventory has too few blocks.
    pub fn turn_free_blocks(&mut self) -> Result<(), BlueprintError> {
        let placements = self.placements()?;
        let is_free: Vec<bool> = self.blocks.iter().map(|block| block.is_free).collect();
        for (block, rotation) in self.blocks.iter_mut().zip(turns::matching(&placements, &is_free)) {
            block.rotation = rotation;
        }
        Ok(())
    }

    /// Checks the drawing as it is.
    ///
    /// # Errors
    /// If the inventory has too few blocks.
    pub fn examine(&self) -> Result<Findings, BlueprintError> {
        let placements = self.placements()?;
        let mut found = Findings { problems: Vec::new(), connections: Vec::new(), blueprint: None };
        self.overlaps(&placements, &mut found);
        self.meetings(&placements, &mut found);
        self.loose(&mut found);
        if found.problems.is_empty() && !placements.is_empty() {
            found.problems.extend(self.topples(&placements));
        }
        if found.problems.is_empty() && placements.len() > 1 {
            match self.blueprint(&placements) {
                Ok(blueprint) => found.blueprint = Some(blueprint),
                Err(error) => {
                    let is_assembly = matches!(error, BlueprintError::NoAssembly { .. });
                    found.problems.push(self.explain(&error, &placements));
                    // A structure that is too weak nearly always lacks an assembly order too, and that error names the
                    // blocks at fault.
                    if let (false, Err(NoAssembly { missing, .. })) =
                        (is_assembly, Assembly::of_placements(&placements))
                    {
                        found.problems.push(self.unreached(&missing, &placements));
                    }
                }
            }
        }
        Ok(found)
    }

    /// Places the blocks with the lowest corner at the origin. The k-th block of a type is the k-th in the inventory.
    fn placements(&self) -> Result<Vec<Placement>, BlueprintError> {
        let inventory = Inventory::standard();
        let mut placements = Vec::with_capacity(self.blocks.len());
        for (i, drawn) in self.blocks.iter().enumerate() {
            let same = inventory.blocks_of_type(&drawn.type_name);
            let n_before = self.blocks[..i].iter().filter(|other| other.type_name == drawn.type_name).count();
            let block = *same.get(n_before).ok_or_else(|| BlueprintError::TooMany {
                block: format!("{} {}", word(&drawn.type_name), n_before + 1),
                type_name: drawn.type_name.clone(),
                count: same.len(),
            })?;
            let size = drawn.rotation.apply(inventory.cells(block).map(i32::from)).map(i32::abs);
            let center_half_units = std::array::from_fn(|k| 2 * drawn.at[k] + size[k]);
            placements.push(Placement { block, center_half_units, rotation: drawn.rotation });
        }
        move_to_origin(&mut placements);
        Ok(placements)
    }

    /// Returns the word for a block, with a number if there are several of its type.
    fn name(&self, i: usize) -> String {
        let types: Vec<&str> = self.blocks.iter().map(|block| block.type_name.as_str()).collect();
        numbered(&types, i, ' ')
    }

    fn names(&self, blocks: &[usize]) -> String {
        let names: Vec<String> = blocks.iter().map(|&i| self.name(i)).collect();
        match names.split_last() {
            Some((last, rest)) if !rest.is_empty() => format!("{} and {last}", rest.join(", ")),
            _ => names.concat(),
        }
    }

    fn problem(&self, check: Check, blocks: Vec<usize>, words: &str) -> Problem {
        let text = format!("{} {words}", self.names(&blocks));
        Problem { check, blocks, text }
    }

    fn overlaps(&self, placements: &[Placement], found: &mut Findings) {
        let mut filled: BTreeMap<[i32; 3], Vec<usize>> = BTreeMap::new();
        for (i, placement) in placements.iter().enumerate() {
            for cell in placement.filled_cells() {
                filled.entry(cell).or_default().push(i);
            }
        }
        let shared: BTreeSet<Vec<usize>> = filled.into_values().filter(|blocks| blocks.len() > 1).collect();
        found.problems.extend(
            shared.into_iter().map(|blocks| self.problem(Check::Overlap, blocks, "overlap: they fill the same place")),
        );
    }

    fn meetings(&self, placements: &[Placement], found: &mut Findings) {
        let inventory = Inventory::standard();
        for (a, first) in placements.iter().enumerate() {
            for (b, second) in placements.iter().enumerate().skip(a + 1) {
                let relative = RelativePlacement::between(first, second);
                let n_magnet_pairs = inventory.magnet_pairs(first.block, second.block, relative).len();
                if n_magnet_pairs > 0 {
                    found.connections.push(Connection { a, b, n_magnet_pairs });
                }
                if !inventory.clashing_pairs(first.block, second.block, relative).is_empty() {
                    let words = "repel each other: like poles meet";
                    found.problems.push(self.problem(Check::Polarity, vec![a, b], words));
                }
            }
        }
    }

    /// Names the blocks outside the largest piece.
    fn loose(&self, found: &mut Findings) {
        let piece = pieces(self.blocks.len(), found.connections.iter().map(|connection| (connection.a, connection.b)));
        let size = |of: usize| piece.iter().filter(|&&p| p == of).count();
        let Some(largest) = piece.iter().copied().max_by_key(|&p| (size(p), std::cmp::Reverse(p))) else { return };
        let loose: Vec<usize> = (0..piece.len()).filter(|&i| piece[i] != largest).collect();
        if !loose.is_empty() {
            let words = if loose.len() == 1 { "is not connected to the rest" } else { "are not connected to the rest" };
            found.problems.push(self.problem(Check::Connected, loose, words));
        }
    }

    fn topples(&self, placements: &[Placement]) -> Option<Problem> {
        let margin_u = support_margin_u(placements);
        let text = "the structure tips over: too little of its lowest layer is under its center of mass".to_owned();
        (margin_u < MIN_SUPPORT_MARGIN_U).then_some(Problem { check: Check::Stands, blocks: Vec::new(), text })
    }

    fn blueprint(&self, placements: &[Placement]) -> Result<Blueprint, BlueprintError> {
        let title: String = self.title.trim().chars().filter(|c| !c.is_control()).take(MAX_TITLE).collect();
        let title = if title.is_empty() { UNTITLED.to_owned() } else { title };
        let blueprint = check_placements(draft_id(placements.len(), 0), Split::Train, title, placements)?;
        let id = draft_id(placements.len(), blueprint.canonical_hash());
        Ok(Blueprint { id, ..blueprint })
    }

    /// Describes a failure of the last checks in terms of the drawing.
    fn explain(&self, error: &BlueprintError, placements: &[Placement]) -> Problem {
        // These errors name a block by its index in the inventory.
        let find = |name: &String| BlockIdx::all().find(|block| block.get().to_string() == *name);
        match error {
            BlueprintError::Overloaded { a, b, .. } => {
                let named: Vec<BlockIdx> = [a, b].into_iter().filter_map(find).collect();
                let words = "are pulled apart: too much hangs on their magnets";
                self.problem(Check::Strength, of_blocks(&named, placements), words)
            }
            BlueprintError::NoAssembly { blocks, .. } => {
                self.unreached(&blocks.iter().filter_map(find).collect::<Vec<_>>(), placements)
            }
            _ => Problem { check: Check::Format, blocks: Vec::new(), text: error.to_string() },
        }
    }

    fn unreached(&self, missing: &[BlockIdx], placements: &[Placement]) -> Problem {
        let blocks = of_blocks(missing, placements);
        let text = format!(
            "the expert cannot place {}: on no side of the structure is there an order in which it stands after every \
             block and each block has a straight way in",
            self.names(&blocks)
        );
        Problem { check: Check::Assembly, blocks, text }
    }
}

/// Returns the indices of these blocks in the drawing.
fn of_blocks(blocks: &[BlockIdx], placements: &[Placement]) -> Vec<usize> {
    (0..placements.len()).filter(|&i| blocks.contains(&placements[i].block)).collect()
}

/// Returns the id of a drawing. Equal structures have equal ids; different ones nearly always differ.
fn draft_id(n_blocks: usize, hash: u64) -> BlueprintId {
    let id = format!("drawn_{}_{:03}", n_blocks.clamp(2, N_BLOCKS), hash % 1000);
    BlueprintId::try_from(id).expect("a size of 2 to 16 and an index of three digits")
}

#[cfg(test)]
mod tests;

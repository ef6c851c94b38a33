//! A drawing in progress: blocks on the lattice that may not form a valid blueprint yet, and the remaining problems.
//!
//! Each of the [`checks`](crate::checks) stops at its first error. An editor needs all errors at once, each with the
//! blocks that it concerns, and needs the blocks rotated so that the poles that meet attract.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use crate::checks::{Check, Structure, check_text};
use crate::error::BlueprintError;
use crate::format::{Draft, DraftBlock, MAX_COORDINATE};
use crate::infer::turns;
use crate::pieces::pieces;
use crate::strength::Joint;
use crate::writer::numbered;
pub use crate::writer::word;
use crate::{Blueprint, BlueprintId, CubeRotation, Inventory, N_BLOCKS, Placement, Split};

/// Maximum number of characters in a title; the rest is cut off.
pub const MAX_TITLE: usize = 80;

/// Title of a drawing without one.
const UNTITLED: &str = "a drawing";

/// A block of a drawing, with the fields that it has in a file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DrawnBlock {
    /// Name of its type in the inventory.
    #[serde(rename = "type")]
    pub type_name: String,
    /// The lowest-numbered corner cell that it fills.
    pub at: [i32; 3],
    /// Directions of its own x and y axes, for example `+x +y`.
    pub axes: String,
    /// Whether the block may take any rotation that fills the same cells.
    #[serde(default)]
    pub is_free: bool,
}

/// Blocks on the lattice.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drawing {
    /// A short description of the structure.
    pub title: String,
    /// The blocks; at most as many of each type as the inventory has.
    pub blocks: Vec<DrawnBlock>,
}

/// Something that keeps a drawing from being a blueprint.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Problem {
    /// The check that fails.
    pub check: Check,
    /// Indices in the drawing of the blocks concerned; empty if the problem concerns all of them.
    pub blocks: Vec<usize>,
    /// One sentence without a period.
    pub text: String,
}

/// Two blocks of a drawing, by index, that hold each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
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
    /// Returns the block as a file would give it.
    fn placed(&self, name: String) -> Result<DraftBlock, BlueprintError> {
        let (type_name, at, axes) = (self.type_name.clone(), self.at, self.axes.clone());
        if at.iter().any(|x| !(-MAX_COORDINATE..=MAX_COORDINATE).contains(x)) {
            return Err(BlueprintError::out_of_range(&type_name, at.map(i64::from)));
        }
        match CubeRotation::from_axes(&axes) {
            Some(rotation) => Ok(DraftBlock { name, type_name, at, turn: Some(rotation), size: None }),
            None => Err(BlueprintError::bad_axes(&type_name, &axes)),
        }
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
            type_name: Inventory::standard().block_type(placement.block).name.to_owned(),
            at: placement.lowest_cell(),
            axes: placement.rotation.axes(),
            is_free: false,
        };
        let blocks = blueprint.placements().iter().map(block).collect();
        Ok(Self { title: blueprint.title().to_owned(), blocks })
    }

    /// Rotates the free blocks, without changing the cells that they fill, so that the poles that meet attract as far as
    /// possible. If no blocks repel each other, all stay as they are.
    ///
    /// # Errors
    /// If a block's axes do not form a rotation, its cell is out of range, or the inventory lacks its type or has too few
    /// blocks of it.
    pub fn turn_free_blocks(&mut self) -> Result<(), BlueprintError> {
        let (mut draft, placements) = self.placed()?;
        if Structure::new(&draft, &placements).repelling.is_empty() {
            return Ok(());
        }
        for (block, drawn) in draft.blocks.iter_mut().zip(&self.blocks) {
            block.turn = block.turn.filter(|_| !drawn.is_free);
        }
        for (block, rotation) in self.blocks.iter_mut().zip(turns(&draft, &placements)?) {
            block.axes = rotation.axes();
        }
        Ok(())
    }

    /// Checks the drawing as it is.
    ///
    /// # Errors
    /// As for [`Self::turn_free_blocks`].
    pub fn examine(&self) -> Result<Findings, BlueprintError> {
        let (draft, placements) = self.placed()?;
        let structure = Structure::new(&draft, &placements);
        let connection = |joint: &Joint| Connection { a: joint.a, b: joint.b, n_magnet_pairs: joint.places.len() };
        let connections: Vec<Connection> = structure.joints.iter().map(connection).collect();
        let mut problems = self.overlaps(&placements);
        let repelling: BTreeSet<[usize; 2]> = structure.repelling.iter().map(|((a, b, ..), _)| [*a, *b]).collect();
        let repel =
            |pair: [usize; 2]| self.problem(Check::Polarity, pair.to_vec(), "repel each other: like poles meet");
        problems.extend(repelling.into_iter().map(repel));
        problems.extend(self.loose(&connections));
        let mut blueprint = None;
        if problems.is_empty() && placements.len() > 1 {
            match structure.check() {
                Ok(()) => blueprint = Some(named(structure.blueprint())),
                Err(error) => problems = self.explain(&error, &structure),
            }
        }
        Ok(Findings { problems, connections, blueprint })
    }

    /// Returns the drawing as a file would give it, and its blocks with the lowest corner at the origin.
    fn placed(&self) -> Result<(Draft, Vec<Placement>), BlueprintError> {
        let blocks = self.blocks.iter().enumerate().map(|(i, drawn)| drawn.placed(self.name(i)));
        let blocks: Vec<DraftBlock> = blocks.collect::<Result<_, _>>()?;
        let turns: Vec<CubeRotation> = blocks.iter().filter_map(|block| block.turn).collect();
        let title: String = self.title.trim().chars().filter(|c| !c.is_control()).take(MAX_TITLE).collect();
        let draft = Draft {
            id: draft_id(self.blocks.len(), 0),
            split: Split::Train,
            title: if title.is_empty() { UNTITLED.to_owned() } else { title },
            up: [0, 0, 1],
            provenance: None,
            blocks,
            pairs: None,
        };
        let placements = draft.place(&draft.assign()?, &turns);
        Ok((draft, placements))
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

    fn overlaps(&self, placements: &[Placement]) -> Vec<Problem> {
        let mut filled: BTreeMap<[i32; 3], Vec<usize>> = BTreeMap::new();
        for (i, placement) in placements.iter().enumerate() {
            for cell in placement.filled_cells() {
                filled.entry(cell).or_default().push(i);
            }
        }
        let shared: BTreeSet<Vec<usize>> = filled.into_values().filter(|blocks| blocks.len() > 1).collect();
        let overlap = |blocks| self.problem(Check::Overlap, blocks, "overlap: they fill the same place");
        shared.into_iter().map(overlap).collect()
    }

    /// Names the blocks outside the largest piece.
    fn loose(&self, connections: &[Connection]) -> Option<Problem> {
        let piece = pieces(self.blocks.len(), connections.iter().map(|connection| (connection.a, connection.b)));
        let size = |of: usize| piece.iter().filter(|&&p| p == of).count();
        let largest = piece.iter().copied().max_by_key(|&p| (size(p), std::cmp::Reverse(p)))?;
        let loose: Vec<usize> = (0..piece.len()).filter(|&i| piece[i] != largest).collect();
        let words = if loose.len() == 1 { "is not connected to the rest" } else { "are not connected to the rest" };
        (!loose.is_empty()).then(|| self.problem(Check::Connected, loose, words))
    }

    /// Describes a failure of the last checks in terms of the drawing.
    fn explain(&self, error: &BlueprintError, structure: &Structure<'_>) -> Vec<Problem> {
        let find = |name: &String| (0..self.blocks.len()).find(|&i| self.name(i) == *name);
        match error {
            BlueprintError::Unsupported { .. } => {
                let text = "the structure tips over: too little of its lowest layer is under its center of mass";
                vec![Problem { check: Check::Stands, blocks: Vec::new(), text: text.to_owned() }]
            }
            BlueprintError::Overloaded { a, b, .. } => {
                let blocks = [a, b].into_iter().filter_map(find).collect();
                let mut problems =
                    vec![self.problem(Check::Strength, blocks, "are pulled apart: too much hangs on their magnets")];
                // A structure that is too weak nearly always lacks an assembly order too, and that error names the
                // blocks at fault.
                if let Err(error) = structure.assembly() {
                    problems.extend(self.explain(&error, structure));
                }
                problems
            }
            BlueprintError::NoAssembly { blocks, .. } => {
                let mut blocks: Vec<usize> = blocks.iter().filter_map(find).collect();
                blocks.sort_unstable();
                let text = format!(
                    "the expert cannot place {}: on no side of the structure is there an order in which it stands \
                     after every block and each block has a straight way in",
                    self.names(&blocks)
                );
                vec![Problem { check: Check::Assembly, blocks, text }]
            }
            _ => vec![Problem { check: Check::Format, blocks: Vec::new(), text: error.to_string() }],
        }
    }
}

/// Returns the blueprint with the id that follows from its structure.
fn named(blueprint: Blueprint) -> Blueprint {
    Blueprint { id: draft_id(blueprint.n_blocks(), blueprint.canonical_hash()), ..blueprint }
}

/// Returns the id of a drawing. Equal structures have equal ids; different ones nearly always differ.
fn draft_id(n_blocks: usize, hash: u64) -> BlueprintId {
    let id = format!("drawn_{}_{:03}", n_blocks.clamp(2, N_BLOCKS), hash % 1000);
    BlueprintId::try_from(id).expect("a size of 2 to 16 and an index of three digits")
}

#[cfg(test)]
mod tests;

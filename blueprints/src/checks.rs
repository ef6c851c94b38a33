//! Named static checks that a blueprint must pass.
//!
//! The loader and `lodestone blueprints check` run the same list. The loader returns the first error, and the command
//! reports all of them.

mod unique;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use serde::Serialize;

use crate::assembly::Shared;
use crate::error::{BlueprintError, BlueprintFileError};
use crate::format::{Draft, MagnetName, NamedPair};
pub use crate::infer::FoundTurn;
use crate::infer::{self, Completed};
use crate::pieces::pieces;
use crate::stance::{MIN_SUPPORT_MARGIN_U, support_margin_u};
use crate::strength::{Joint, overloaded};
use crate::{Assembly, BlockIdx, Blueprint, BlueprintId, Inventory, Link, NoAssembly, Placement, RelativePlacement};
pub use unique::check_all;

/// A check of one file; variants are in running order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Check {
    /// The text parses as a blueprint.
    Format,
    /// The inventory has enough blocks of each type.
    Inventory,
    /// Blocks without `axes` fit where the file places them.
    Turns,
    /// No two blocks fill the same cell.
    Overlap,
    /// No like poles meet.
    Polarity,
    /// The listed magnet pairs are exactly those that meet.
    Connections,
    /// The structure is one piece.
    Connected,
    /// The center of mass is over the support polygon by at least [`MIN_SUPPORT_MARGIN_U`].
    Stands,
    /// No connection carries more than half of its breaking load in the default world, by a static estimate.
    Strength,
    /// Single blocks can be added in some order such that every intermediate structure stands.
    Assembly,
    /// No other file has the same id or the same structure.
    Unique,
    /// Built in a simulated world, the structure hardly moves for two seconds and loses no connection.
    Settles,
    /// The scripted expert builds it within an episode.
    Expert,
}

/// The outcome of a check.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(tag = "outcome", rename_all = "kebab-case")]
pub enum Outcome {
    /// The check passed.
    Passed,
    /// The check failed.
    Failed {
        /// The reason, in one line.
        error: String,
    },
    /// The check did not run because an earlier one failed.
    Skipped,
}

/// A check and its outcome.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct CheckResult {
    /// The check.
    pub check: Check,
    /// The outcome.
    #[serde(flatten)]
    pub outcome: Outcome,
}

/// The results of all checks of one file.
#[derive(Clone, Debug)]
pub struct Report {
    /// Name of the file.
    pub file: String,
    /// The id, if the text parses.
    pub id: Option<BlueprintId>,
    /// One result per check, in order; [`Check::Unique`] only if several files were checked together.
    pub results: Vec<CheckResult>,
    /// What the file leaves open, as inferred.
    pub inferred: Vec<Inferred>,
    /// The file's text with everything inferred filled in, if the blueprint is valid and anything was inferred.
    pub completed: Option<String>,
    /// The blueprint if all checks but uniqueness passed, otherwise the first error.
    pub blueprint: Result<Blueprint, BlueprintFileError>,
}

/// A part of a blueprint that its file leaves open.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Inferred {
    /// The rotation of a block.
    Turn {
        /// The block's name.
        block: String,
        /// Directions of the block's own x and y axes, as written in a file.
        axes: String,
        /// How the rotation was found.
        found: FoundTurn,
    },
    /// The magnet pairs of two blocks.
    Pairs {
        /// Name of one block.
        a: String,
        /// Name of the other block.
        b: String,
        /// Number of magnet pairs that meet.
        n_pairs: usize,
    },
}

impl Inferred {
    /// Returns whether this is one of several possibilities.
    pub fn is_a_choice(&self) -> bool {
        matches!(self, Self::Turn { found, .. } if found.is_a_choice())
    }
}

impl fmt::Display for Inferred {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Turn { block, axes, found } => write!(f, "block {block:?} is turned \"{axes}\"{found}"),
            Self::Pairs { a, b, n_pairs } => {
                let s = if *n_pairs == 1 { "" } else { "s" };
                write!(f, "blocks {a:?} and {b:?} are connected by {n_pairs} magnet pair{s}")
            }
        }
    }
}

impl Check {
    /// The checks that need a simulated world. This crate only names them.
    pub const PHYSICAL: [Self; 2] = [Self::Settles, Self::Expert];

    /// All static checks, in order.
    pub const ALL: [Self; 11] = [
        Self::Format,
        Self::Inventory,
        Self::Turns,
        Self::Overlap,
        Self::Polarity,
        Self::Connections,
        Self::Connected,
        Self::Stands,
        Self::Strength,
        Self::Assembly,
        Self::Unique,
    ];
}

impl fmt::Display for Check {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // The name in JSON.
        self.serialize(f)
    }
}

impl Report {
    /// Returns whether every check passed.
    pub fn passed(&self) -> bool {
        self.results.iter().all(|result| result.outcome == Outcome::Passed)
    }
}

/// Runs every check except [`Check::Unique`] on a file's text. `file` appears in messages and provides the id if the
/// text has none.
///
/// # Example
/// ```
/// use blueprints::checks::check_text;
///
/// let report = check_text("mine.toml", "id = \"2_000\"");
/// assert!(!report.passed());
/// assert!(report.blueprint.is_err_and(|error| error.to_string().starts_with("mine.toml: line 1: missing field")));
/// ```
pub fn check_text(file: &str, text: &str) -> Report {
    let mut run = Run::default();
    let draft = run.record(Check::Format, Draft::parse(file, text));
    let assigned = draft.as_ref().and_then(|draft| run.record(Check::Inventory, draft.assign()));
    let found = draft.as_ref().zip(assigned.as_ref()).and_then(|(draft, assigned)| {
        let ways = infer::completions(draft, assigned).map(|ways| first_good(draft, assigned, ways));
        run.record(Check::Turns, ways).flatten()
    });
    let mut blueprint = None;
    let mut inferred = Vec::new();
    let mut completed = None;
    if let (Some(draft), Some((completion, placements))) = (&draft, &found) {
        let structure = Structure::new(draft, placements);
        let apart = run.record(Check::Overlap, structure.overlap());
        let attract = run.record(Check::Polarity, structure.polarity());
        // Magnets do not hold blocks that overlap or repel. Whatever hangs on them would also be reported as loose or
        // too heavy, so skip these checks.
        let is_held = apart.and(attract).is_some();
        run.record(Check::Connections, structure.connections());
        run.record_if(is_held, Check::Connected, || structure.connected());
        run.record(Check::Stands, structure.stands());
        run.record_if(is_held, Check::Strength, || structure.strength());
        // Search for an assembly order only if every earlier check passed.
        if run.first_error.is_none() {
            run.record(Check::Assembly, structure.assembly());
        }
        inferred = structure.inferred(completion);
        blueprint = run.first_error.is_none().then(|| structure.blueprint());
        completed = blueprint.as_ref().filter(|_| !inferred.is_empty()).map(|blueprint| structure.completed(blueprint));
    }
    for check in Check::ALL.into_iter().take(Check::ALL.len() - 1).skip(run.results.len()) {
        run.results.push(CheckResult { check, outcome: Outcome::Skipped });
    }
    let blueprint = match run.first_error {
        Some(error) => Err(BlueprintFileError { file: file.to_owned(), error }),
        None => Ok(blueprint.expect("without an error every stage has run")),
    };
    Report {
        file: file.to_owned(),
        id: draft.map(|draft| draft.id),
        results: run.results,
        inferred,
        completed,
        blueprint,
    }
}

/// Returns the first completion that passes the checks, or else the first one, so that its errors are reported.
fn first_good(
    draft: &Draft,
    assigned: &[BlockIdx],
    completions: Vec<Completed>,
) -> Option<(Completed, Vec<Placement>)> {
    let place = |way: &Completed| draft.place(assigned, &way.turns);
    let is_good = |way: &Completed| Structure::new(draft, &place(way)).check().is_ok();
    // If there is only one completion, the checks that follow judge it.
    let at = if completions.len() == 1 { 0 } else { completions.iter().position(is_good).unwrap_or(0) };
    let chosen = completions.into_iter().nth(at)?;
    let placements = place(&chosen);
    Some((chosen, placements))
}

#[derive(Default)]
struct Run {
    results: Vec<CheckResult>,
    first_error: Option<BlueprintError>,
}

impl Run {
    fn record<T>(&mut self, check: Check, result: Result<T, BlueprintError>) -> Option<T> {
        let (outcome, value) = match result {
            Ok(value) => (Outcome::Passed, Some(value)),
            Err(error) => {
                let outcome = Outcome::Failed { error: error.to_string() };
                self.first_error.get_or_insert(error);
                (outcome, None)
            }
        };
        self.results.push(CheckResult { check, outcome });
        value
    }

    /// Records a check if it makes sense, and reports it as skipped otherwise.
    fn record_if(&mut self, makes_sense: bool, check: Check, run: impl FnOnce() -> Result<(), BlueprintError>) {
        if makes_sense {
            self.record(check, run());
        } else {
            self.results.push(CheckResult { check, outcome: Outcome::Skipped });
        }
    }
}

/// A placed drawing with all magnet pairs that meet; blocks are numbered in file order.
pub(crate) struct Structure<'a> {
    draft: &'a Draft,
    placements: &'a [Placement],
    attracting: BTreeSet<NamedPair>,
    /// Repelling magnet pairs, each with the point where they meet, in half units.
    pub(crate) repelling: Vec<(NamedPair, [i32; 3])>,
    /// Contacts where blocks attract each other.
    pub(crate) joints: Vec<Joint>,
}

impl<'a> Structure<'a> {
    pub(crate) fn new(draft: &'a Draft, placements: &'a [Placement]) -> Self {
        let inventory = Inventory::standard();
        let mut attracting = BTreeSet::new();
        let mut repelling = Vec::new();
        let mut joints = Vec::new();
        for (i, a) in placements.iter().enumerate() {
            for (j, b) in placements.iter().enumerate().skip(i + 1) {
                let relative = RelativePlacement::between(a, b);
                let named = |(p, q)| (i, j, MagnetName::of(a.block, p), MagnetName::of(b.block, q));
                let place = |p: usize| {
                    let turned = a.rotation.apply(inventory.magnets(a.block)[p].position_half_units);
                    std::array::from_fn(|k| a.center_half_units[k] + turned[k])
                };
                let pairs = inventory.magnet_pairs(a.block, b.block, relative);
                if !pairs.is_empty() {
                    joints.push(Joint { a: i, b: j, places: pairs.iter().map(|&(p, _)| place(p)).collect() });
                }
                attracting.extend(pairs.into_iter().map(named));
                for (p, q) in inventory.clashing_pairs(a.block, b.block, relative) {
                    repelling.push((named((p, q)), place(p)));
                }
            }
        }
        Self { draft, placements, attracting, repelling, joints }
    }

    /// Runs the checks of the structure in order, up to the first failure.
    pub(crate) fn check(&self) -> Result<(), BlueprintError> {
        self.overlap()?;
        self.polarity()?;
        self.connections()?;
        self.connected()?;
        self.stands()?;
        self.strength()?;
        self.assembly()
    }

    /// Returns what the file leaves open.
    fn inferred(&self, completed: &Completed) -> Vec<Inferred> {
        let turn = |(i, found): (usize, &Option<FoundTurn>)| {
            let found = found.clone()?;
            Some(Inferred::Turn { block: self.name(i), axes: completed.turns[i].axes(), found })
        };
        let mut inferred: Vec<_> = completed.found.iter().enumerate().filter_map(turn).collect();
        if self.draft.pairs.is_none() {
            let pairs = |joint: &Joint| Inferred::Pairs {
                a: self.name(joint.a),
                b: self.name(joint.b),
                n_pairs: joint.places.len(),
            };
            inferred.extend(self.joints.iter().map(pairs));
        }
        inferred
    }

    /// Returns the file's text with everything inferred filled in; blocks keep their names.
    fn completed(&self, blueprint: &Blueprint) -> String {
        let names: Vec<String> = blueprint.placements().iter().map(|p| self.name_of(p.block)).collect();
        blueprint.to_toml_with(&names, self.draft.provenance.as_deref().unwrap_or("not given"))
    }

    fn name(&self, i: usize) -> String {
        self.draft.blocks[i].name.clone()
    }

    fn name_of(&self, block: BlockIdx) -> String {
        self.name(self.placements.iter().take_while(|p| p.block != block).count())
    }

    fn overlap(&self) -> Result<(), BlueprintError> {
        let mut filled = BTreeMap::new();
        for (i, placement) in self.placements.iter().enumerate() {
            for cell in placement.filled_cells() {
                if let Some(other) = filled.insert(cell, i) {
                    let center = self.draft.drawn(cell.map(|x| 2 * x + 1), self.placements);
                    let cell = center.map(|x| (x - 1) / 2);
                    let (a, b) = (self.name(other), self.name(i));
                    return Err(BlueprintError::Invalid(format!(
                        "blocks {a:?} and {b:?} overlap in cell {cell:?}; move one of them"
                    )));
                }
            }
        }
        Ok(())
    }

    fn polarity(&self) -> Result<(), BlueprintError> {
        self.repelling.first().map_or(Ok(()), |&((i, j, p, q), place)| {
            let a = self.name(i);
            let b = self.name(j);
            let place_u = self.draft.drawn(place, self.placements).map(|x| x as f32 / 2.0);
            let advice = if [i, j].iter().any(|&k| self.draft.blocks[k].turn.is_some()) {
                "turn one, or leave out its `axes`"
            } else if self.draft.blocks.iter().any(|block| block.turn.is_some()) {
                "move one, or leave out the `axes` of the blocks around them"
            } else {
                "no turns let all blocks attract, so move one, or let it lie another way with `size`"
            };
            Err(BlueprintError::Invalid(format!(
                "blocks {a:?} and {b:?} repel: like poles meet at {place_u:?}, pair \"{p} {q}\"; {advice}"
            )))
        })
    }

    fn connections(&self) -> Result<(), BlueprintError> {
        let Some(listed) = &self.draft.pairs else { return Ok(()) };
        if let Some((i, j, p, q)) = listed.difference(&self.attracting).next() {
            let (a, b) = (self.name(*i), self.name(*j));
            return Err(BlueprintError::Invalid(format!(
                "the magnets \"{p} {q}\" of blocks {a:?} and {b:?} do not meet with opposite poles"
            )));
        }
        if let Some((i, j, p, q)) = self.attracting.difference(listed).next() {
            let (a, b) = (self.name(*i), self.name(*j));
            return Err(BlueprintError::Invalid(format!(
                "blocks {a:?} and {b:?} also meet with the magnets \"{p} {q}\"; list the pair"
            )));
        }
        Ok(())
    }

    fn connected(&self) -> Result<(), BlueprintError> {
        let pieces = pieces(self.placements.len(), self.joints.iter().map(|joint| (joint.a, joint.b)));
        let loose = pieces.iter().position(|&piece| piece != 0);
        let refused = |i| format!("block {:?} is not connected to {:?}", self.name(i), self.name(0));
        loose.map_or(Ok(()), |i| Err(BlueprintError::Invalid(refused(i))))
    }

    fn stands(&self) -> Result<(), BlueprintError> {
        let margin_u = support_margin_u(self.placements);
        if margin_u >= MIN_SUPPORT_MARGIN_U {
            return Ok(());
        }
        Err(BlueprintError::Unsupported { margin_u, min_u: MIN_SUPPORT_MARGIN_U })
    }

    fn strength(&self) -> Result<(), BlueprintError> {
        let cells: Vec<_> = self.placements.iter().map(|p| p.filled_cells()).collect();
        overloaded(&cells, &self.joints, 0).map_or(Ok(()), |(at, load)| {
            let joint = &self.joints[at];
            let n_pairs = joint.places.len();
            Err(BlueprintError::Overloaded { a: self.name(joint.a), b: self.name(joint.b), n_pairs, load })
        })
    }

    pub(crate) fn assembly(&self) -> Result<(), BlueprintError> {
        // In the order of the blueprint, because the search depends on it among equals.
        Assembly::of_placements(&self.by_block()).map(|_| ()).map_err(|NoAssembly { missing, gave_up }| {
            BlueprintError::NoAssembly {
                blocks: missing.into_iter().map(|block| self.name_of(block)).collect(),
                gave_up,
            }
        })
    }

    fn by_block(&self) -> Vec<Placement> {
        let mut placements = self.placements.to_vec();
        placements.sort_by_key(|p| p.block);
        placements
    }

    pub(crate) fn blueprint(&self) -> Blueprint {
        let link = |joint: &Joint| {
            let mut pair = [joint.a, joint.b].map(|i| &self.placements[i]);
            pair.sort_by_key(|p| p.block);
            let relative = RelativePlacement::between(pair[0], pair[1]);
            // Blocks do not overlap here, so at most one face of each meets the other, with 6 magnets at most.
            let n_magnet_pairs = u8::try_from(joint.places.len()).unwrap_or(u8::MAX);
            Link { a: pair[0].block, b: pair[1].block, relative, n_magnet_pairs }
        };
        let mut links: Vec<Link> = self.joints.iter().map(link).collect();
        links.sort_by_key(|link| (link.a, link.b));
        let placements = self.by_block();
        Blueprint {
            id: self.draft.id.clone(),
            split: self.draft.split,
            title: self.draft.title.clone(),
            assembly: Shared::new(&placements),
            placements,
            links,
        }
    }
}

#[cfg(test)]
mod tests;

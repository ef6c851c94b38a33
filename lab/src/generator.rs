//! Procedural generation of structures, each of which can be built again from its id.
//!
//! A structured style draws a shape (a tower, an arch, a letter), fills it with blocks of the inventory, and rotates
//! them so that all magnets that meet attract; [`Style::Any`] grows block by block. A structure that fails a check is
//! discarded and drawn again.

mod brick;
mod dice;
mod features;
mod growth;
mod poles;
mod search;
mod sketch;
mod style;
mod tiling;

use std::collections::BTreeSet;

use blueprints::checks::check_text;
use blueprints::error::BlueprintError;
use blueprints::placement::extent_u;
use blueprints::{Blueprint, BlueprintId, Inventory, Placement};
use clap::ValueEnum;
use dice::Dice;
pub(crate) use style::Style;

/// Version of the generator, part of every id. An id always names the same structure, so a change in the output needs a
/// new version. Ids of other versions are unknown.
const VERSION: u32 = 1;

/// Largest index of a structure with one style, seed, and size: ids have three digits for the index.
pub(crate) const MAX_INDEX: u16 = 999;

/// Identifies one generated structure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(crate) struct Request {
    /// The style.
    pub(crate) style: Style,
    /// Seed; different seeds give different structures.
    pub(crate) seed: u64,
    /// Number of blocks, within the style's [`sizes`](Style::sizes).
    pub(crate) n_blocks: usize,
    /// Index among the structures of this style, seed, and size, 0 to [`MAX_INDEX`].
    pub(crate) index: u16,
}

/// Reasons why a structure could not be generated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(crate) enum GenerateError {
    /// The style does not support this number of blocks.
    #[error("style {style} needs {} to {} blocks, not {n_blocks}", style.sizes().start(), style.sizes().end())]
    Size {
        /// The style.
        style: Style,
        /// The requested number of blocks.
        n_blocks: usize,
    },
    /// The index does not fit into an id.
    #[error("index {0} of a generated blueprint is not in 0..=999")]
    Index(u16),
    /// The bounded search found no structure.
    #[error("found no sound structure for {id} in {n_draws} draws; try another seed or index")]
    Exhausted {
        /// The structure's id.
        id: BlueprintId,
        /// Number of shapes drawn.
        n_draws: usize,
    },
    /// There are too few distinct structures.
    #[error("seed {seed} gives {n_found} different structures of style {style} and {n_blocks} blocks, not {count}")]
    TooFew {
        /// The style.
        style: Style,
        /// The seed.
        seed: u64,
        /// The number of blocks.
        n_blocks: usize,
        /// The requested number of structures.
        count: usize,
        /// The number of structures found.
        n_found: usize,
    },
    /// A structure that the generator accepted fails a file check, which is a bug in the generator.
    #[error("the structure of {id} fails a check")]
    Unsound {
        /// The structure's id.
        id: BlueprintId,
        /// The failed check.
        #[source]
        error: BlueprintError,
    },
}

impl Request {
    /// Returns the structure's id, `gen<version>-<style>-<seed, hexadecimal>_<size>_<index>`.
    ///
    /// # Errors
    /// [`GenerateError::Size`] and [`GenerateError::Index`] if there is no such structure.
    pub(crate) fn id(&self) -> Result<BlueprintId, GenerateError> {
        let Self { style, seed, n_blocks, index } = *self;
        if !style.sizes().contains(&n_blocks) {
            return Err(GenerateError::Size { style, n_blocks });
        }
        if index > MAX_INDEX {
            return Err(GenerateError::Index(index));
        }
        let text = format!("gen{VERSION}-{style}-{seed:x}_{n_blocks}_{index:03}");
        Ok(BlueprintId::try_from(text).expect("styles and numbers are letters, digits, - and _"))
    }

    /// Returns the request that an id encodes; `None` unless it is the id of a generated structure of this [`VERSION`].
    pub(crate) fn from_id(id: &BlueprintId) -> Option<Self> {
        let (prefix, index) = id.as_str().rsplit_once('_')?;
        let (prefix, _) = prefix.rsplit_once('_')?;
        let (style, seed) = prefix.strip_prefix(&format!("gen{VERSION}-"))?.rsplit_once('-')?;
        let seed = u64::from_str_radix(seed, 16).ok()?;
        let request =
            Self { style: Style::from_str(style, false).ok()?, seed, n_blocks: id.size()?, index: index.parse().ok()? };
        // Leading zeros of the seed would give one structure two ids.
        (request.id().as_ref() == Ok(id)).then_some(request)
    }

    /// Returns the origin of the structure, for its file.
    pub(crate) fn provenance(&self) -> String {
        let Self { style, seed, index, .. } = self;
        format!("generated: version {VERSION}, style {style}, seed {seed}, index {index}")
    }

    fn dice(&self) -> Dice {
        let mut bytes = [0; 32];
        bytes[..8].copy_from_slice(&self.seed.to_le_bytes());
        bytes[8..10].copy_from_slice(&self.index.to_le_bytes());
        bytes[10] = self.n_blocks as u8;
        bytes[11..15].copy_from_slice(&VERSION.to_le_bytes());
        // Use the style's name, so that a new style in the middle of the list does not change the others.
        for (byte, letter) in bytes[16..].iter_mut().zip(self.style.to_string().bytes()) {
            *byte = letter;
        }
        Dice::new(bytes)
    }
}

/// Generates one structure. It passes all file checks and has an assembly order.
///
/// Equal requests give equal blueprints on every machine. Their split is that of training.
///
/// # Errors
/// [`GenerateError::Size`] and [`GenerateError::Index`] for a request outside the range, and
/// [`GenerateError::Exhausted`] for the rare request without a structure.
pub(crate) fn generate(request: &Request) -> Result<Blueprint, GenerateError> {
    let id = request.id()?;
    let found = search::search(request.style, request.n_blocks, &mut request.dice())
        .map_err(|n_draws| GenerateError::Exhausted { id: id.clone(), n_draws })?;
    let block = |placement: &Placement| {
        let type_name = Inventory::standard().block_type(placement.block).name;
        let (at, axes) = (placement.filled_cells()[0], placement.rotation.axes());
        format!("    {{ type = \"{type_name}\", at = {at:?}, axes = \"{axes}\" }},\n")
    };
    let blocks: String = found.placements.iter().map(block).collect();
    let text = format!("id = \"{id}\"\ntitle = {:?}\nblocks = [\n{blocks}]\n", title(&found, request.style));
    let checked = check_text(&format!("{id}.toml"), &text).blueprint;
    checked.map_err(|error| GenerateError::Unsound { id, error: error.error })
}

/// Generates `count` structures that differ from each other as much as possible, by increasing index.
///
/// They are chosen by composition and appearance from a pool of about four times as many. No two have the same
/// [canonical hash](Blueprint::canonical_hash), and none has a hash in `exclude`, so that training goals never equal a
/// held-out structure.
///
/// # Errors
/// Those of [`generate`], and [`GenerateError::TooFew`] if the indices run out first.
pub(crate) fn generate_many(
    style: Style,
    seed: u64,
    n_blocks: usize,
    count: usize,
    exclude: &BTreeSet<u64>,
) -> Result<Vec<Blueprint>, GenerateError> {
    let mut seen = exclude.clone();
    let mut pool = Vec::new();
    for index in 0..=MAX_INDEX {
        if pool.len() >= 4 * count + 8 {
            break;
        }
        match generate(&Request { style, seed, n_blocks, index }) {
            Ok(blueprint) if seen.insert(blueprint.canonical_hash()) => pool.push(blueprint),
            // A request without a structure, or with a known one, adds no candidate.
            Ok(_) | Err(GenerateError::Exhausted { .. }) => {}
            Err(error) => return Err(error),
        }
        // Small sizes have few structures, so stop before drawing the same ones again and again.
        if pool.len() >= count && usize::from(index) > 8 * count + 64 {
            break;
        }
    }
    if pool.len() < count {
        return Err(GenerateError::TooFew { style, seed, n_blocks, count, n_found: pool.len() });
    }
    Ok(features::most_different(pool, count))
}

/// Returns a title with the shape, the number of blocks, and the characteristic size.
fn title(found: &search::Found, style: Style) -> String {
    let n_blocks = found.placements.len();
    let [x, y, z] = extent_u(&found.placements);
    match style {
        Style::Longest => format!("{} of {n_blocks} blocks, {} u long", found.words, x.max(y)),
        _ => format!("{} of {n_blocks} blocks, {z} u high", found.words),
    }
}

#[cfg(test)]
mod tests;

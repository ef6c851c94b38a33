//! Structures made by rule and chance instead of by hand, each named by an id that any process can make it from.
//!
//! A structured style draws a shape (a tower, an arch, a letter), fills it with blocks of the inventory and turns them
//! so that all magnets that meet attract; [`Style::Any`] grows block by block. What fails a check is thrown away and
//! drawn anew.

mod brick;
mod dice;
mod draws;
mod features;
mod growth;
mod poles;
mod search;
mod sketch;
mod style;
mod tiling;

use parking_lot::Mutex;
use std::collections::BTreeSet;
use std::num::NonZeroUsize;
use std::sync::LazyLock;

use lru::LruCache;

use crate::checks::check_placements;
use crate::error::BlueprintError;
use crate::{Blueprint, BlueprintId, Split};
use dice::Dice;
pub use draws::{Draws, MAX_DRAWN_SEED};
pub use style::{InvalidStyle, Style};

/// Version of the rules, part of every id: the same id names the same structure for ever, so a change in what the
/// generator makes is a new version, and ids of other versions are unknown.
pub const VERSION: u32 = 1;

/// Number of structures of one style, seed and size: ids have three digits for the index.
pub const MAX_INDEX: u16 = 999;

/// Names one generated structure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Request {
    /// What it looks like.
    pub style: Style,
    /// Any number; other seeds give other structures.
    pub seed: u64,
    /// How many blocks, within the style's [`sizes`](Style::sizes).
    pub n_blocks: usize,
    /// Which of the structures of this style, seed and size, 0 to [`MAX_INDEX`].
    pub index: u16,
}

/// Why nothing was generated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GenerateError {
    /// The style needs another number of blocks.
    #[error("style {style} needs {} to {} blocks, not {n_blocks}", style.sizes().start(), style.sizes().end())]
    Size {
        /// The style.
        style: Style,
        /// The number asked for.
        n_blocks: usize,
    },
    /// The index does not fit into an id.
    #[error("index {0} of a generated blueprint is not in 0..=999")]
    Index(u16),
    /// The bounded search ended without a structure.
    #[error("found no sound structure for {id} in {n_draws} draws; try another seed or index")]
    Exhausted {
        /// The structure's id.
        id: BlueprintId,
        /// Shapes that were drawn.
        n_draws: usize,
    },
    /// There are not enough different structures.
    #[error("seed {seed} gives {n_found} different structures of style {style} and {n_blocks} blocks, not {count}")]
    TooFew {
        /// The style.
        style: Style,
        /// The seed.
        seed: u64,
        /// The number of blocks.
        n_blocks: usize,
        /// The number asked for.
        count: usize,
        /// The number there is.
        n_found: usize,
    },
    /// A structure that the generator took for sound fails a check of files, which is an error in the generator.
    #[error("the structure of {id} fails a check")]
    Unsound {
        /// The structure's id.
        id: BlueprintId,
        /// What is wrong with it.
        #[source]
        error: BlueprintError,
    },
}

impl Request {
    /// The structure's id, `gen<version>-<style>-<seed, hexadecimal>_<size>_<index>`.
    ///
    /// # Errors
    /// [`GenerateError::Size`] and [`GenerateError::Index`] if there is no such structure.
    pub fn id(&self) -> Result<BlueprintId, GenerateError> {
        let Self { style, seed, n_blocks, index } = *self;
        if !style.sizes().contains(&n_blocks) {
            return Err(GenerateError::Size { style, n_blocks });
        }
        let text = format!("gen{VERSION}-{style}-{seed:x}_{n_blocks}_{index:03}");
        BlueprintId::try_from(text).map_err(|_| GenerateError::Index(index))
    }

    /// The request that an id encodes; `None` if it is not the id of a generated structure of this [`VERSION`].
    pub fn from_id(id: &BlueprintId) -> Option<Self> {
        let (prefix, index) = id.as_str().rsplit_once('_')?;
        let (prefix, _) = prefix.rsplit_once('_')?;
        let (style, seed) = prefix.strip_prefix(&format!("gen{VERSION}-"))?.rsplit_once('-')?;
        let seed = u64::from_str_radix(seed, 16).ok()?;
        let request = Self { style: style.parse().ok()?, seed, n_blocks: id.size(), index: index.parse().ok()? };
        // Leading zeros of the seed would give one structure two names.
        (request.id().as_ref() == Ok(id)).then_some(request)
    }

    /// Where a structure comes from, for its file.
    pub fn provenance(&self) -> String {
        let Self { style, seed, index, .. } = self;
        format!("generated: version {VERSION}, style {style}, seed {seed}, index {index}")
    }

    fn dice(&self) -> Dice {
        let mut bytes = [0; 32];
        bytes[..8].copy_from_slice(&self.seed.to_le_bytes());
        bytes[8..10].copy_from_slice(&self.index.to_le_bytes());
        bytes[10] = self.n_blocks as u8;
        bytes[11..15].copy_from_slice(&VERSION.to_le_bytes());
        // By name, so that a new style in the middle of the list changes no other.
        for (byte, letter) in bytes[16..].iter_mut().zip(self.style.as_str().bytes()) {
            *byte = letter;
        }
        Dice::new(bytes)
    }
}

/// Makes one structure. It has passed all checks of a file and there is an order in which it can be put together.
///
/// Equal requests give equal blueprints on every machine. The split is [`Split::Train`].
///
/// # Errors
/// [`GenerateError::Size`] and [`GenerateError::Index`] for a request outside the range, and
/// [`GenerateError::Exhausted`] for the rare one that comes to nothing.
pub fn generate(request: &Request) -> Result<Blueprint, GenerateError> {
    let id = request.id()?;
    let (found, effort) = search::search(request.style, request.n_blocks, &mut request.dice());
    let Some(found) = found else {
        return Err(GenerateError::Exhausted { id, n_draws: effort.n_draws });
    };
    let title = title(&found, request.style);
    check_placements(id.clone(), Split::Train, title, &found.placements)
        .map_err(|error| GenerateError::Unsound { id, error })
}

/// Makes the structure that an id names; `None` if it is not the id of a generated structure of this [`VERSION`].
pub fn from_id(id: &BlueprintId) -> Option<Result<Blueprint, GenerateError>> {
    Request::from_id(id).map(|request| generate(&request))
}

/// Structures that are kept by [`made`], of a few kilobytes each: more than the episodes that a process has in hand.
pub const MADE_CAPACITY: NonZeroUsize = NonZeroUsize::new(4096).expect("it is not zero");

/// Like [`from_id`], of one that was made lately a copy; `None` also if the request comes to nothing.
pub fn made(id: &BlueprintId) -> Option<Blueprint> {
    static MADE: LazyLock<Mutex<LruCache<BlueprintId, Option<Blueprint>>>> =
        LazyLock::new(|| Mutex::new(LruCache::new(MADE_CAPACITY)));
    let request = Request::from_id(id)?;
    let lock = || MADE.lock();
    if let Some(known) = lock().get(id) {
        return known.clone();
    }
    // Made without the lock, so that others need not wait.
    let blueprint = generate(&request).ok();
    lock().put(id.clone(), blueprint.clone());
    blueprint
}

/// Makes `count` structures that differ as much as possible from each other, by increasing index.
///
/// They are chosen from a pool of about four times as many by what they are made of and how they look. No two have the
/// same [canonical hash](Blueprint::canonical_hash), and none has one of `exclude`, so that goals of training never
/// equal a held-out structure.
///
/// # Errors
/// As [`generate`], and [`GenerateError::TooFew`] if the indices are used up first.
pub fn generate_many(
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
            // A request that comes to nothing is one candidate fewer, as is one whose structure is taken.
            Ok(_) | Err(GenerateError::Exhausted { .. }) => {}
            Err(error) => return Err(error),
        }
        // Small sizes have few structures: no use in drawing the same ones again and again.
        if pool.len() >= count && usize::from(index) > 8 * count + 64 {
            break;
        }
    }
    if pool.len() < count {
        return Err(GenerateError::TooFew { style, seed, n_blocks, count, n_found: pool.len() });
    }
    Ok(features::most_different(pool, count))
}

/// What the structure shows, of how many blocks, and its characteristic size.
fn title(found: &search::Found, style: Style) -> String {
    let n_blocks = found.placements.len();
    match style {
        Style::Longest => {
            format!("{} of {n_blocks} blocks, {} u long", found.words, found.extent(0).max(found.extent(1)))
        }
        _ => format!("{} of {n_blocks} blocks, {} u high", found.words, found.extent(2)),
    }
}

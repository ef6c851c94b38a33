//! The set of blueprints of a run, compiled in or loaded from a folder.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock};
use std::{fs, io};

use crate::checks::{Inferred, check_text};
use crate::error::BlueprintFileError;
use crate::format::line_at;
use crate::outside::{self, printable};
use crate::{Blueprint, BlueprintId, Split};

/// The `(file name, text)` of every compiled-in blueprint file.
pub const BUILTIN_FILES: &[(&str, &str)] = include!(concat!(env!("OUT_DIR"), "/catalog.rs"));

/// Maximum size of a blueprint file in bytes; the largest in the catalog has about 4400.
pub const MAX_FILE_BYTES: u64 = 1 << 20;

/// Blueprints with distinct ids and structures.
///
/// # Example
/// ```
/// use blueprints::{Catalog, Split};
///
/// let catalog = Catalog::builtin();
/// let blueprint = catalog.get(&"4_000".parse()?).expect("the catalog has it");
/// assert_eq!(blueprint.n_blocks(), 4);
/// assert!(catalog.of_split(Split::Test).iter().all(|test| !catalog.is_for_training(test)));
/// # Ok::<(), blueprints::blueprint::InvalidBlueprintId>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Catalog {
    blueprints: Vec<Blueprint>,
    /// Outline hashes of the held-out blueprints.
    held_out: BTreeSet<u64>,
}

/// Reasons to reject a catalog.
#[derive(Debug, thiserror::Error)]
pub enum CatalogError {
    /// A file is not a valid blueprint.
    #[error(transparent)]
    Blueprint(#[from] BlueprintFileError),
    /// A folder or file cannot be read or is not text, there is none, or two files contradict each other.
    #[error("{0}")]
    Files(String),
}

impl Catalog {
    /// Returns the compiled-in blueprints.
    ///
    /// # Panics
    /// Never in a build that passes the tests: the files are compiled in.
    pub fn builtin() -> &'static Arc<Self> {
        static BUILTIN: LazyLock<Arc<Catalog>> = LazyLock::new(|| {
            let builtin = Catalog::from_files(BUILTIN_FILES.iter().copied());
            Arc::new(builtin.expect("the embedded blueprints are valid"))
        });
        &BUILTIN
    }

    /// Reads every `*.toml` file of a folder, or one file. The files may have any name; see [`read_files`].
    ///
    /// # Errors
    /// The first error, in file name order; see [`CatalogError`].
    pub fn load(path: &Path) -> Result<Self, CatalogError> {
        Ok(Self::load_with_inferred(path)?.0)
    }

    /// Like [`Self::load`], with what the files leave open, each after the name of its file.
    ///
    /// # Errors
    /// As for [`Self::load`].
    pub fn load_with_inferred(path: &Path) -> Result<(Self, Vec<(String, Inferred)>), CatalogError> {
        let files = read_files(path)?;
        let (mut checked, mut inferred) = (Vec::new(), Vec::new());
        for (file, text) in &files {
            let report = check_text(file, text);
            checked.push((file.as_str(), report.blueprint?));
            inferred.extend(report.inferred.into_iter().map(|found| (file.clone(), found)));
        }
        Ok((Self::from_checked(checked)?, inferred))
    }

    /// Builds a catalog from `(file name, text)` pairs; every file must be named after its blueprint.
    ///
    /// # Errors
    /// The first error, in the order given.
    pub fn from_files<'a>(files: impl IntoIterator<Item = (&'a str, &'a str)>) -> Result<Self, CatalogError> {
        let check = |(file, text)| Ok((file, check_text(file, text).blueprint?));
        let files = files.into_iter().map(check).collect::<Result<Vec<_>, CatalogError>>()?;
        for (file, blueprint) in &files {
            let id = blueprint.id();
            if Path::new(file).file_name().and_then(|name| name.to_str()) != Some(&format!("{id}.toml")) {
                return refused(format!("{file}: the file of blueprint {id} must be called {id}.toml"));
            }
        }
        Self::from_checked(files)
    }

    /// Returns this catalog merged with another one, whose blueprints replace those with the same id or structure.
    #[must_use]
    pub fn with(&self, others: &Self) -> Self {
        let structures: BTreeSet<u64> = others.iter().map(Blueprint::canonical_hash).collect();
        let stays = |old: &&Blueprint| others.get(old.id()).is_none() && !structures.contains(&old.canonical_hash());
        Self::new(self.iter().filter(stays).chain(others.iter()).cloned().collect())
    }

    /// Creates a catalog of one blueprint.
    pub fn of_one(blueprint: Blueprint) -> Self {
        Self::new(vec![blueprint])
    }

    fn from_checked(files: Vec<(&str, Blueprint)>) -> Result<Self, CatalogError> {
        let mut blueprints: Vec<Blueprint> = Vec::new();
        let mut by_hash: BTreeMap<u64, (BlueprintId, Split)> = BTreeMap::new();
        for (file, blueprint) in files {
            let id = blueprint.id().clone();
            let split = blueprint.split();
            if blueprints.iter().any(|other| *other.id() == id) {
                return refused(format!("{file}: the id {id} is taken by another file"));
            }
            if let Some((other, other_split)) = by_hash.insert(blueprint.canonical_hash(), (id.clone(), split)) {
                return refused(if (split == Split::Train) == (other_split == Split::Train) {
                    format!("{file}: {id} is the same structure as {other}")
                } else {
                    format!(
                        "{file}: {id} ({split}) is the same structure as {other} ({other_split}); training would see a \
                         test"
                    )
                });
            }
            blueprints.push(blueprint);
        }
        Ok(Self::new(blueprints))
    }

    /// Sorts by split, size, and id. Size comes before id because 12_000 sorts before 2_000 as text.
    fn new(mut blueprints: Vec<Blueprint>) -> Self {
        blueprints.sort_by_cached_key(|b| (b.split(), b.n_blocks(), b.id().clone()));
        let held_out = blueprints.iter().filter(|b| b.split() != Split::Train).map(Blueprint::outline_hash).collect();
        Self { blueprints, held_out }
    }

    /// Returns the blueprint with that id.
    pub fn get(&self, id: &BlueprintId) -> Option<&Blueprint> {
        self.iter().find(|blueprint| blueprint.id() == id)
    }

    /// Returns the blueprint with the id of this one, if it is another structure. Two names for one structure do no
    /// harm, but one name for two structures would hide one of them.
    pub fn namesake(&self, blueprint: &Blueprint) -> Option<&Blueprint> {
        self.get(blueprint.id()).filter(|other| other.canonical_hash() != blueprint.canonical_hash())
    }

    /// Returns whether training may use a structure, which must not share its outline with a held-out structure.
    /// Mirroring a structure, swapping its poles, or tiling its cells with other blocks does not change the outline.
    pub fn is_for_training(&self, blueprint: &Blueprint) -> bool {
        !self.held_out.contains(&blueprint.outline_hash())
    }

    /// Returns the held-out blueprint that keeps this one from training, if any.
    pub fn held_out_like(&self, blueprint: &Blueprint) -> Option<&Blueprint> {
        let outline = blueprint.outline_hash();
        self.iter().find(|other| other.split() != Split::Train && other.outline_hash() == outline)
    }

    /// Iterates over the blueprints by split, then size, then id.
    pub fn iter(&self) -> std::slice::Iter<'_, Blueprint> {
        self.blueprints.iter()
    }

    /// Returns the blueprints of one split by size, then id.
    pub fn of_split(&self, split: Split) -> Vec<&Blueprint> {
        self.iter().filter(|blueprint| blueprint.split() == split).collect()
    }

    /// Returns the number of blueprints.
    pub fn len(&self) -> usize {
        self.blueprints.len()
    }

    /// Returns whether the catalog is empty.
    pub fn is_empty(&self) -> bool {
        self.blueprints.is_empty()
    }
}

/// Reads the `(path to show, text)` of every `*.toml` file of a folder, sorted by name, or of one file with any name. In
/// a folder, names that begin with a dot are passed over: they are the locks and copies of editors and file systems.
///
/// # Errors
/// If a folder has no such files, or a file cannot be read, is larger than [`MAX_FILE_BYTES`], or is not UTF-8 text.
pub fn read_files(path: &Path) -> Result<Vec<(String, String)>, CatalogError> {
    let failed = |path: &Path| {
        let path = path.display().to_string();
        move |error: io::Error| CatalogError::Files(format!("cannot read {path}: {error}"))
    };
    let mut paths = Vec::new();
    if path.is_dir() {
        for entry in fs::read_dir(path).map_err(failed(path))? {
            let entry = entry.map_err(failed(path))?;
            let (name, path) = (entry.file_name(), entry.path());
            if path.extension().is_some_and(|extension| extension == "toml") && !is_hidden(&name) {
                paths.push(path);
            }
        }
        // Do not return an empty list, because it would pass every check.
        if paths.is_empty() {
            let shown = path.display();
            return refused(format!("the folder {shown} holds no blueprint; name one with files called *.toml"));
        }
        paths.sort();
    } else {
        paths.push(path.to_owned());
    }
    let read = |path: PathBuf| {
        let bytes = outside::read(&path, MAX_FILE_BYTES).map_err(failed(&path))?;
        let text = text_of(&path, bytes)?;
        Ok((printable(&path.display().to_string()).into_owned(), text))
    };
    paths.into_iter().map(read).collect()
}

/// Returns whether a folder's listing usually leaves out this name.
pub fn is_hidden(name: &OsStr) -> bool {
    name.as_encoded_bytes().starts_with(b".")
}

/// Decodes a file's bytes as UTF-8.
fn text_of(path: &Path, bytes: Vec<u8>) -> Result<String, CatalogError> {
    String::from_utf8(bytes).map_err(|error| {
        let bytes = error.as_bytes();
        let at = error.utf8_error().valid_up_to();
        let (shown, line, byte) = (path.display(), line_at(bytes, at), bytes[at]);
        CatalogError::Files(format!(
            "{shown} is not UTF-8 text: line {line} has the byte {byte:#04x}; save it as UTF-8"
        ))
    })
}

fn refused<T>(why: String) -> Result<T, CatalogError> {
    Err(CatalogError::Files(why))
}

#[cfg(test)]
mod tests;

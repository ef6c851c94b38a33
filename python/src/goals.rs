//! Selection of goals: blueprint ids, splits, and user files.

use std::ffi::CString;
use std::path::Path;
use std::sync::Arc;

use blueprints::catalog::read_files;
use blueprints::checks::check_text;
use blueprints::{Blueprint, BlueprintId, Catalog, CatalogError, Split};
use pyo3::exceptions::PyUserWarning;
use pyo3::{PyErr, PyResult, Python, pyfunction};

use crate::error::refused;

/// Goals, and the catalog that contains them.
#[derive(Clone, Debug)]
pub(crate) struct Goals {
    /// The built-in catalog plus the user's files.
    pub(crate) catalog: Arc<Catalog>,
    /// The goals in the given order, at least one.
    pub(crate) ids: Vec<BlueprintId>,
    /// Names that give the same goals without any file: in place of a file or its text, a text for each blueprint.
    pub(crate) sources: Vec<String>,
    /// One line per block in the user's files whose orientation is ambiguous, with the one that was chosen.
    choices: Vec<String>,
}

/// Why a list of goals is rejected.
#[derive(Debug, thiserror::Error)]
pub(crate) enum GoalError {
    /// The list is empty.
    #[error("blueprint is an empty list: expected at least one")]
    Empty,
    /// Neither a file nor anything in the catalog or the generator.
    #[error(
        "blueprint {0:?} is unknown: expected an id such as 4_000, a split ({splits}), or the path of a TOML file or folder",
        splits = Split::ALL.map(|split| split.to_string()).join(", ")
    )]
    Unknown(String),
    /// Not an id, where a single blueprint is expected.
    #[error(
        "blueprint {0:?} is unknown: expected one id, such as 4_000, of the catalog, of the generator, or of a file \
         among the environment's blueprints"
    )]
    UnknownId(String),
    /// The catalog keeps only one blueprint per structure, so this one could not be played.
    #[error("blueprint {0} is the same structure as another one in the list: name only one of them")]
    Replaced(BlueprintId),
    /// Two different blueprints with one id, of which only the last could be played.
    #[error("two different blueprints are called {0}: give one of the two another `id`")]
    Repeated(BlueprintId),
    /// A file is not a valid blueprint.
    #[error("blueprint")]
    File(#[from] CatalogError),
}

impl Goals {
    /// Resolves `names`: ids of the catalog or the generator, splits, paths of files or folders, and texts of files.
    ///
    /// # Errors
    /// Returns an error if no goals result, a name is unknown, two goals share an id, or one goal replaces another.
    pub(crate) fn new(names: &[String]) -> Result<Self, GoalError> {
        let mut catalog = Catalog::builtin().as_ref().clone();
        let mut ids = Vec::new();
        let (mut sources, mut choices) = (Vec::new(), Vec::new());
        for name in names {
            if name.contains('\n') {
                let file = "the text of a blueprint";
                choices.extend(chosen(file, name));
                let own = Catalog::of_one(check_text(file, name).blueprint.map_err(CatalogError::from)?);
                sources.extend(texts(&own));
                add(&own, &mut ids, &mut catalog)?;
            } else if is_path(&catalog, name) {
                let path = Path::new(name);
                let own = Catalog::load(path)?;
                for (file, text) in read_files(path)? {
                    choices.extend(chosen(&file, &text));
                }
                sources.extend(texts(&own));
                add(&own, &mut ids, &mut catalog)?;
            } else if let Ok(split) = name.parse::<Split>() {
                sources.push(name.clone());
                ids.extend(catalog.of_split(split).into_iter().map(Blueprint::id).cloned());
            } else {
                ids.push(known(&catalog, name).ok_or_else(|| GoalError::Unknown(name.clone()))?);
                sources.push(name.clone());
            }
        }
        if ids.is_empty() {
            return Err(GoalError::Empty);
        }
        if let Some(gone) = ids.iter().find(|id| catalog.get(id).is_none()) {
            return Err(GoalError::Replaced(gone.clone()));
        }
        Ok(Self { catalog: Arc::new(catalog), ids, sources, choices })
    }

    /// Warns about each block with an ambiguous orientation; `stack_level` counts the Python frames up to the caller.
    ///
    /// # Errors
    /// Returns an error if Python turns warnings into errors.
    pub(crate) fn warn(&self, py: Python<'_>, stack_level: i32) -> PyResult<()> {
        let category = py.get_type::<PyUserWarning>();
        let warn = |line: &String| PyErr::warn(py, &category, &CString::new(line.as_str())?, stack_level);
        self.choices.iter().try_for_each(warn)
    }

    /// Returns the number of blocks of a goal.
    pub(crate) fn n_blocks(&self, goal: &BlueprintId) -> usize {
        self.catalog.get(goal).map_or(0, Blueprint::n_blocks)
    }
}

/// Returns a text for each blueprint, in which nothing is left open.
fn texts(own: &Catalog) -> impl Iterator<Item = String> {
    own.iter().map(|blueprint| blueprint.to_toml("a goal that was given"))
}

/// Adds the user's own blueprints to the goals and the catalog.
///
/// # Errors
/// Returns an error if another structure, of the catalog or among the goals, has the same id.
fn add(own: &Catalog, ids: &mut Vec<BlueprintId>, catalog: &mut Catalog) -> Result<(), GoalError> {
    if let Some(blueprint) = own.iter().find(|blueprint| catalog.namesake(blueprint).is_some()) {
        return Err(GoalError::Repeated(blueprint.id().clone()));
    }
    ids.extend(own.iter().map(Blueprint::id).cloned());
    *catalog = catalog.with(own);
    Ok(())
}

/// Parses an id. Returns `None` unless the catalog has that blueprint.
fn known(catalog: &Catalog, name: &str) -> Option<BlueprintId> {
    name.parse::<BlueprintId>().ok().filter(|id| catalog.get(id).is_some())
}

/// Parses an id where a single blueprint is expected.
///
/// # Errors
/// Returns an error if that blueprint does not exist.
pub(crate) fn known_id(catalog: &Catalog, name: &str) -> Result<BlueprintId, GoalError> {
    known(catalog, name).ok_or_else(|| GoalError::UnknownId(name.to_owned()))
}

/// Returns whether a name refers to a file or folder. Splits and ids take precedence over folders of the same name.
fn is_path(catalog: &Catalog, name: &str) -> bool {
    let is_named = || name.parse::<Split>().is_ok() || known(catalog, name).is_some();
    name.contains('/') || name.ends_with(".toml") || (!is_named() && Path::new(name).exists())
}

/// Describes, for each block in a file's text with an ambiguous orientation, which one was chosen.
fn chosen(file: &str, text: &str) -> Vec<String> {
    let inferred = check_text(file, text).inferred;
    let choices = inferred.iter().filter(|found| found.is_a_choice());
    choices.map(|found| format!("{file}: {found}; `axes` in the file chooses another")).collect()
}

/// Returns the ids and block counts of blueprints.
#[pyfunction(name = "blueprints")]
pub(crate) fn named(py: Python<'_>, names: Vec<String>) -> PyResult<Vec<(String, usize)>> {
    let goals = Goals::new(&names).map_err(|error| refused(&error))?;
    // Skips the frame of `lodestone.blueprints` and attributes the warning to its caller.
    goals.warn(py, 2)?;
    Ok(goals.ids.iter().map(|id| (id.to_string(), goals.n_blocks(id))).collect())
}

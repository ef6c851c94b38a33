//! Selection of goals: blueprint ids, splits, and user files.

use std::ffi::CString;
use std::path::Path;
use std::sync::Arc;

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
    #[error("blueprint is an empty list: expected at least one")]
    Empty,
    #[error(
        "blueprint {0:?} is unknown: expected an id such as 4_000, a split ({splits}), or the path of a TOML file or folder",
        splits = Split::ALL.map(|split| split.to_string()).join(", ")
    )]
    Unknown(String),
    #[error(
        "blueprint {0:?} is unknown: expected one id, such as 4_000, of the catalog or of a file among the environment's \
         blueprints"
    )]
    UnknownId(String),
    /// The catalog keeps only one blueprint per structure, so this one could not be played.
    #[error("blueprint {0} is the same structure as another one in the list: name only one of them")]
    Replaced(BlueprintId),
    /// Two different blueprints with one id, of which only the last could be played.
    #[error("two different blueprints are called {0}: give one of the two another `id`")]
    Repeated(BlueprintId),
    #[error("blueprint")]
    File(#[from] CatalogError),
}

impl Goals {
    /// Resolves `names`: ids of the catalog, splits, paths of files or folders, and texts of files.
    pub(crate) fn new(names: &[String]) -> Result<Self, GoalError> {
        let mut catalog = Catalog::builtin().as_ref().clone();
        let mut ids = Vec::new();
        let (mut sources, mut choices) = (Vec::new(), Vec::new());
        for name in names {
            let (own, inferred) = if name.contains('\n') {
                let report = check_text("the text of a blueprint", name);
                let inferred = report.inferred.into_iter().map(|found| (report.file.clone(), found)).collect();
                (Catalog::of_one(report.blueprint.map_err(CatalogError::from)?), inferred)
            } else if is_path(&catalog, name) {
                Catalog::load_with_inferred(Path::new(name))?
            } else {
                match name.parse::<Split>() {
                    Ok(split) => ids.extend(catalog.of_split(split).into_iter().map(Blueprint::id).cloned()),
                    Err(_) => ids.push(known(&catalog, name).ok_or_else(|| GoalError::Unknown(name.clone()))?),
                }
                sources.push(name.clone());
                continue;
            };
            let chosen = inferred.iter().filter(|(_, found)| found.is_a_choice());
            choices.extend(chosen.map(|(file, found)| format!("{file}: {found}; `axes` in the file chooses another")));
            // Another structure, of the catalog or among the goals, must not have the same id.
            if let Some(blueprint) = own.iter().find(|blueprint| catalog.namesake(blueprint).is_some()) {
                return Err(GoalError::Repeated(blueprint.id().clone()));
            }
            sources.extend(own.iter().map(|blueprint| blueprint.to_toml("a goal that was given")));
            ids.extend(own.iter().map(Blueprint::id).cloned());
            catalog = catalog.with(&own);
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

/// Parses an id. Returns `None` unless the catalog has that blueprint.
fn known(catalog: &Catalog, name: &str) -> Option<BlueprintId> {
    name.parse::<BlueprintId>().ok().filter(|id| catalog.get(id).is_some())
}

/// Parses an id where a single blueprint is expected.
pub(crate) fn known_id(catalog: &Catalog, name: &str) -> Result<BlueprintId, GoalError> {
    known(catalog, name).ok_or_else(|| GoalError::UnknownId(name.to_owned()))
}

/// Returns whether a name refers to a file or folder. Splits and ids take precedence over folders of the same name.
fn is_path(catalog: &Catalog, name: &str) -> bool {
    let is_named = || name.parse::<Split>().is_ok() || known(catalog, name).is_some();
    name.contains('/') || name.ends_with(".toml") || (!is_named() && Path::new(name).exists())
}

/// Returns the ids and block counts of blueprints.
#[pyfunction(name = "blueprints")]
pub(crate) fn named(py: Python<'_>, names: Vec<String>) -> PyResult<Vec<(String, usize)>> {
    let goals = Goals::new(&names).map_err(refused)?;
    // Skips the frame of `lodestone.blueprints` and attributes the warning to its caller.
    goals.warn(py, 2)?;
    Ok(goals.ids.iter().map(|id| (id.to_string(), goals.n_blocks(id))).collect())
}

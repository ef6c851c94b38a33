//! Which blueprints are goals: ids, splits, and files of one's own.

use std::ffi::CString;
use std::path::Path;
use std::sync::Arc;

use blueprints::catalog::read_files;
use blueprints::checks::check_text;
use blueprints::{Blueprint, BlueprintId, Catalog, CatalogError, Split};
use pyo3::exceptions::PyUserWarning;
use pyo3::{PyErr, PyResult, Python, pyfunction};

use crate::error::refused;

/// Goals, and the catalog that has them.
#[derive(Clone, Debug)]
pub(crate) struct Goals {
    /// The built-in catalog with the files of one's own.
    pub(crate) catalog: Arc<Catalog>,
    /// The goals in the order given, at least one.
    pub(crate) ids: Vec<BlueprintId>,
    /// A line for each block of one's own files that could lie in several ways: which one was taken.
    choices: Vec<String>,
}

/// Why a list of goals is refused.
#[derive(Debug, thiserror::Error)]
pub(crate) enum GoalError {
    /// Nothing was asked for.
    #[error("the list of blueprints is empty")]
    Empty,
    /// Neither a file nor anything that the catalog knows.
    #[error(
        "blueprint {0:?} is unknown: expected an id such as 4_000, a split ({splits}), or the path of a TOML file or folder",
        splits = Split::ALL.map(|split| split.to_string()).join(", ")
    )]
    Unknown(String),
    /// No id, where only one blueprint can be meant.
    #[error(
        "blueprint {0:?} is unknown: expected one id, such as 4_000, of the catalog, of the generator, or of a file \
         among the environment's blueprints"
    )]
    UnknownId(String),
    /// A catalog keeps one blueprint of a structure, so this one could not be played.
    #[error("blueprint {0} is the same structure as another one in the list: name only one of them")]
    Replaced(BlueprintId),
    /// A file is no blueprint.
    #[error(transparent)]
    File(#[from] CatalogError),
}

impl Goals {
    /// The goals that `names` name: ids of the catalog or the generator, splits, paths of files or folders, and texts of files.
    ///
    /// # Errors
    /// When there are none, one of them is unknown, or one takes the place of another.
    pub(crate) fn new(names: &[String]) -> Result<Self, GoalError> {
        let mut catalog = Catalog::builtin().clone();
        let mut ids = Vec::new();
        let mut choices = Vec::new();
        for name in names {
            if name.contains('\n') {
                let file = "the text of a blueprint";
                choices.extend(chosen(file, name));
                let own = check_text(file, name).blueprint.map_err(CatalogError::from)?;
                ids.push(own.id().clone());
                catalog = catalog.with(&Catalog::of_one(own));
            } else if is_path(&catalog, name) {
                let path = Path::new(name);
                let own = Catalog::load(path)?;
                for (file, text) in read_files(path)? {
                    choices.extend(chosen(&file, &text));
                }
                ids.extend(own.iter().map(Blueprint::id).cloned());
                catalog = catalog.with(&own);
            } else if let Ok(split) = name.parse::<Split>() {
                ids.extend(catalog.of_split(split).into_iter().map(Blueprint::id).cloned());
            } else {
                ids.push(known(&catalog, name).ok_or_else(|| GoalError::Unknown(name.clone()))?);
            }
        }
        if ids.is_empty() {
            return Err(GoalError::Empty);
        }
        if let Some(gone) = ids.iter().find(|id| catalog.find(id).is_none()) {
            return Err(GoalError::Replaced(gone.clone()));
        }
        Ok(Self { catalog: Arc::new(catalog), ids, choices })
    }

    /// Warns of each block that could lie in several ways; `stack_level` counts the frames of Python up to the caller.
    ///
    /// # Errors
    /// When Python makes errors of warnings.
    pub(crate) fn warn(&self, py: Python<'_>, stack_level: i32) -> PyResult<()> {
        let category = py.get_type::<PyUserWarning>();
        let warn = |line: &String| PyErr::warn(py, &category, &CString::new(line.as_str())?, stack_level);
        self.choices.iter().try_for_each(warn)
    }

    /// Blocks of a goal.
    pub(crate) fn n_blocks(&self, goal: &BlueprintId) -> usize {
        self.catalog.find(goal).map_or(0, |blueprint| blueprint.n_blocks())
    }
}

/// The id in a text, if the catalog or the generator has that blueprint.
fn known(catalog: &Catalog, name: &str) -> Option<BlueprintId> {
    name.parse::<BlueprintId>().ok().filter(|id| catalog.find(id).is_some())
}

/// The same where only one blueprint can be meant.
///
/// # Errors
/// When there is no such blueprint.
pub(crate) fn known_id(catalog: &Catalog, name: &str) -> Result<BlueprintId, GoalError> {
    known(catalog, name).ok_or_else(|| GoalError::UnknownId(name.to_owned()))
}

/// Whether a name is that of a file or folder. A split or an id is none even where a folder is called so.
fn is_path(catalog: &Catalog, name: &str) -> bool {
    let is_named = || name.parse::<Split>().is_ok() || known(catalog, name).is_some();
    name.contains('/') || name.ends_with(".toml") || (!is_named() && Path::new(name).exists())
}

/// Of the blocks in a file's text that could lie in several ways, which way was taken.
fn chosen(file: &str, text: &str) -> Vec<String> {
    let inferred = check_text(file, text).inferred;
    let choices = inferred.iter().filter(|found| found.is_a_choice());
    choices.map(|found| format!("{file}: {found}; `axes` in the file chooses another")).collect()
}

/// Ids and numbers of blocks of blueprints.
#[pyfunction(name = "blueprints")]
pub(crate) fn named(py: Python<'_>, names: Vec<String>) -> PyResult<Vec<(String, usize)>> {
    let goals = Goals::new(&names).map_err(|error| refused(&error))?;
    // Past `lodestone.blueprints`, to whoever calls it.
    goals.warn(py, 2)?;
    Ok(goals.ids.iter().map(|id| (id.to_string(), goals.n_blocks(id))).collect())
}

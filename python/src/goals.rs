//! Which blueprints are goals: ids, splits, and files of one's own.

use std::path::Path;
use std::sync::Arc;

use blueprints::checks::check_text;
use blueprints::{Blueprint, BlueprintId, Catalog, CatalogError, Split};
use pyo3::{PyResult, pyfunction};

use crate::error::refused;

/// Goals, and the catalog that has them.
#[derive(Clone, Debug)]
pub(crate) struct Goals {
    /// The built-in catalog with the files of one's own.
    pub(crate) catalog: Arc<Catalog>,
    /// The goals in the order given, at least one.
    pub(crate) ids: Vec<BlueprintId>,
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
    /// A file is no blueprint.
    #[error(transparent)]
    File(#[from] CatalogError),
}

impl Goals {
    /// The goals that `names` name: ids of the catalog or the generator, splits, paths of files or folders, and texts of files.
    ///
    /// # Errors
    /// When there are none, or one of them is unknown.
    pub(crate) fn new(names: &[String]) -> Result<Self, GoalError> {
        let mut catalog = Catalog::builtin().clone();
        let mut ids = Vec::new();
        for name in names {
            let path = Path::new(name);
            if name.contains('\n') {
                let own = check_text("the text of a blueprint", name).blueprint.map_err(CatalogError::from)?;
                ids.push(own.id().clone());
                catalog = catalog.with(&Catalog::of_one(own));
            } else if path.extension().is_some_and(|extension| extension == "toml") || path.is_dir() {
                let own = Catalog::load(path)?;
                ids.extend(own.iter().map(Blueprint::id).cloned());
                catalog = catalog.with(&own);
            } else if let Ok(split) = name.parse::<Split>() {
                ids.extend(catalog.of_split(split).into_iter().map(Blueprint::id).cloned());
            } else {
                ids.push(known(&catalog, name)?);
            }
        }
        if ids.is_empty() {
            return Err(GoalError::Empty);
        }
        Ok(Self { catalog: Arc::new(catalog), ids })
    }

    /// Blocks of a goal.
    pub(crate) fn n_blocks(&self, goal: &BlueprintId) -> usize {
        self.catalog.find(goal).map_or(0, |blueprint| blueprint.n_blocks())
    }
}

/// The id in a text, of a blueprint that the catalog or the generator has.
///
/// # Errors
/// When there is no such blueprint.
pub(crate) fn known(catalog: &Catalog, name: &str) -> Result<BlueprintId, GoalError> {
    let id = name.parse::<BlueprintId>().ok();
    id.filter(|id| catalog.find(id).is_some()).ok_or_else(|| GoalError::Unknown(name.to_owned()))
}

/// Ids and numbers of blocks of blueprints.
#[pyfunction(name = "blueprints")]
pub(crate) fn named(names: Vec<String>) -> PyResult<Vec<(String, usize)>> {
    let goals = Goals::new(&names).map_err(|error| refused(&error))?;
    Ok(goals.ids.iter().map(|id| (id.to_string(), goals.n_blocks(id))).collect())
}

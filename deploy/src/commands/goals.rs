//! Which blueprints a command is about: those of the catalog, generated ones, and files of one's own.

use std::borrow::Cow;
use std::path::Path;

use blueprints::{Blueprint, BlueprintId, Catalog, N_BLOCKS};

use crate::config::{Override, nearest};
use crate::exit::Failure;

/// Named blueprints, and the catalog that has them beside those of the program.
pub(super) struct Goals {
    catalog: Cow<'static, Catalog>,
    ids: Vec<BlueprintId>,
}

impl Goals {
    /// Finds what is named: each a file, a folder of files, or an id.
    ///
    /// # Errors
    /// Names the file that is no blueprint, or the id that is unknown with the nearest one.
    pub(super) fn open(named: &[String]) -> Result<Self, Failure> {
        let mut catalog = Cow::Borrowed(Catalog::builtin());
        let mut ids: Vec<BlueprintId> = Vec::new();
        for name in named {
            let found: Vec<BlueprintId> = if is_path(name) {
                let own = Catalog::load(Path::new(name))?;
                catalog = Cow::Owned(catalog.with(&own));
                own.iter().map(|blueprint| blueprint.id().clone()).collect()
            } else {
                vec![find(&catalog, name)?.id().clone()]
            };
            for id in found {
                if !ids.contains(&id) {
                    ids.push(id);
                }
            }
        }
        Ok(Self { catalog, ids })
    }

    /// Where all of them, and all of the program's own, are found.
    pub(super) fn catalog(&self) -> &Catalog {
        &self.catalog
    }

    /// The same catalog alone.
    pub(super) fn into_catalog(self) -> Catalog {
        self.catalog.into_owned()
    }

    /// The named ones in the order of their names; none if nothing was named.
    ///
    /// # Errors
    /// When a file that was named later has the structure of an earlier one.
    pub(super) fn blueprints(&self) -> Result<Vec<Cow<'_, Blueprint>>, Failure> {
        self.ids.iter().map(|id| find(&self.catalog, id.as_str())).collect()
    }
}

/// The settings of a training on these blueprints alone.
///
/// # Errors
/// When one is a file, which learner and actors could not look up, or unknown.
pub(super) fn trained(ids: &[String]) -> Result<Vec<Override>, Failure> {
    if ids.is_empty() {
        return Ok(Vec::new());
    }
    for id in ids {
        if is_path(id) {
            return Err(Failure::Usage(format!(
                "--blueprint {id}: training takes ids of the catalog (`lodestone blueprints list`), not files; `eval`, \
                 `expert eval`, `render` and `blueprints show` take both"
            )));
        }
        find(Catalog::builtin(), id)?;
    }
    let flag = |path: &str, value: toml::Value| Override::flag("--blueprint", path, value);
    Ok(vec![
        flag("actor.tasks.filter.blueprints", ids.to_vec().into()),
        flag("actor.tasks.generated_probability", 0.0_f64.into()),
        flag("evaluator.selection.splits", vec!["train"].into()),
        flag("evaluator.selection.sizes", vec![2, N_BLOCKS as i64].into()),
        flag("evaluator.selection.blueprints", ids.to_vec().into()),
    ])
}

/// The blueprint of the catalog or of the generator with that id.
///
/// # Errors
/// When there is none; the error has the nearest id of the catalog.
pub(super) fn find<'c>(catalog: &'c Catalog, id: &str) -> Result<Cow<'c, Blueprint>, Failure> {
    let found = id.parse::<BlueprintId>().ok().and_then(|id| catalog.find(&id));
    found.ok_or_else(|| Failure::UnknownBlueprint {
        id: id.to_owned(),
        nearest: nearest(id, catalog.iter().map(|blueprint| blueprint.id().as_str())),
    })
}

/// Whether a name is that of a file or folder. An id is an id even where a folder is called so.
fn is_path(name: &str) -> bool {
    let is_id = || name.parse::<BlueprintId>().is_ok_and(|id| Catalog::builtin().find(&id).is_some());
    name.contains('/') || name.ends_with(".toml") || (!is_id() && Path::new(name).exists())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ids(named: &[&str]) -> Vec<String> {
        let named: Vec<String> = named.iter().map(|&name| name.to_owned()).collect();
        let goals = Goals::open(&named).unwrap();
        goals.blueprints().unwrap().iter().map(|blueprint| blueprint.id().to_string()).collect()
    }

    #[test]
    fn files_folders_and_ids_can_be_named() {
        let folder = tempfile::tempdir().unwrap();
        let text = |id: &str| Catalog::builtin().get(&id.parse().unwrap()).unwrap().to_toml("a test");
        std::fs::write(folder.path().join("a.toml"), text("2_003").replace("2_003", "2_900")).unwrap();
        std::fs::write(folder.path().join("b.toml"), text("3_001").replace("3_001", "3_900")).unwrap();
        let own = folder.path().display().to_string();
        assert_eq!(ids(&[]), Vec::<String>::new());
        assert_eq!(ids(&["6_005", "gen1-any-0_6_000", "6_005"]), ["6_005", "gen1-any-0_6_000"]);
        assert_eq!(ids(&["6_005", &own]), ["6_005", "2_900", "3_900"]);
        assert_eq!(ids(&[&format!("{own}/b.toml")]), ["3_900"]);
    }

    #[test]
    fn training_takes_ids_only() {
        let settings = trained(&["6_005".to_owned()]).unwrap();
        let config =
            crate::config::merge("base = \"laptop\"", "file", crate::config::Base::Defaults, &settings).unwrap();
        config.validate().unwrap();
        let goals = config.evaluator.selection.select(Catalog::builtin()).unwrap();
        assert_eq!(goals.iter().map(|goal| goal.id().as_str()).collect::<Vec<_>>(), ["6_005"]);
        for (name, words) in [("my.toml", "not files"), ("6-005", "did you mean `6_005`")] {
            let message = trained(&[name.to_owned()]).unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
        }
    }
}

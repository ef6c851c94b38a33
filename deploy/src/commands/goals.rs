//! Resolves the blueprints that a command is about: from the catalog, or from the user's files.

use std::collections::BTreeMap;
use std::ffi::{OsStr, OsString};
use std::path::Path;
use std::sync::Arc;

use anyhow::anyhow;
use blueprints::checks::Inferred;
use blueprints::{Blueprint, BlueprintId, Catalog, N_BLOCKS, Split};
use evaluator::Selection;
use runlog::RunPaths;

use super::files::{read_json, write_files};
use crate::config::{Override, nearest, suggestion_or};
use crate::exit::Failure;
use crate::live::Terminal;

/// Named blueprints, and a catalog that contains them in addition to the built-in ones.
pub(super) struct Goals {
    pub(super) catalog: Arc<Catalog>,
    /// Blueprints that the built-in catalog lacks. The folder of a run keeps a copy of them.
    own: Vec<BlueprintId>,
    /// The named blueprints, in the order in which they were named; the catalog has all of them.
    pub(super) ids: Vec<BlueprintId>,
    /// What was inferred to complete the named files, and the file that it is in.
    pub(super) inferred: Vec<(String, Inferred)>,
}

/// A named blueprint, and the name that it was found by.
struct Named {
    id: BlueprintId,
    structure: u64,
    /// The id, file, or folder as given.
    name: OsString,
}

impl Goals {
    /// Resolves names, each of which is a file, a folder of files, or an id. Ids may also refer to the blueprints kept
    /// with a run; `run` is the run's folder or a path in it.
    ///
    /// # Errors
    /// Names the file that is not a blueprint, or the unknown id and the nearest known one; also when a blueprint of
    /// the run cannot be read, or is not the one that the run began with.
    pub(super) fn open_beside(named: &[OsString], run: Option<&Path>) -> Result<Self, Failure> {
        let catalog = Catalog::builtin().clone();
        let mut goals = Self { catalog, own: Vec::new(), ids: Vec::new(), inferred: Vec::new() };
        let kept = run.and_then(run_of).map(|run| run.blueprints());
        if let Some(folder) = kept.filter(|folder| folder.is_dir()) {
            let kept = Catalog::load(&folder)?;
            check_unchanged(&folder, &kept)?;
            goals.add(&kept);
        }
        let mut before: Vec<Named> = Vec::new();
        for name in named {
            let found = if is_path(name) {
                let (own, inferred) = Catalog::load_with_inferred(Path::new(name))?;
                goals.inferred.extend(inferred);
                if let Some(hidden) = own.iter().find_map(|own| Catalog::builtin().namesake(own)) {
                    let id = hidden.id();
                    return Err(Failure::Usage(format!(
                        "{}: the id {id} is taken by another structure of the catalog; give the file another `id`",
                        name.display()
                    )));
                }
                own
            } else {
                let id = name.to_string_lossy();
                // A file with the same structure may already have replaced the built-in blueprint.
                let found = find(&goals.catalog, &id).or_else(|error| find(Catalog::builtin(), &id).map_err(|_| error));
                Catalog::of_one(found?.clone())
            };
            for blueprint in found.iter() {
                let id = blueprint.id().clone();
                let structure = blueprint.canonical_hash();
                if !is_repeated(&before, &id, structure, name)? {
                    before.push(Named { id, structure, name: name.clone() });
                }
            }
            goals.add(&found);
        }
        goals.ids = before.into_iter().map(|named| named.id).collect();
        Ok(goals)
    }

    /// Adds the blueprints that are new or that differ from the catalog's.
    fn add(&mut self, others: &Catalog) {
        let is_new = |blueprint: &&Blueprint| self.catalog.get(blueprint.id()) != Some(*blueprint);
        let new: Vec<BlueprintId> = others.iter().filter(is_new).map(|blueprint| blueprint.id().clone()).collect();
        if !new.is_empty() {
            self.catalog = Arc::new(self.catalog.with(others));
            self.own.retain(|id| !new.contains(id));
            self.own.extend(new);
        }
    }

    /// The named blueprints; empty if none were.
    pub(super) fn blueprints(&self) -> Vec<&Blueprint> {
        self.ids.iter().filter_map(|id| self.catalog.get(id)).collect()
    }

    /// The named blueprints, or else those of `selection`.
    pub(super) fn or_selected(&self, selection: &Selection) -> Result<Vec<&Blueprint>, Failure> {
        if self.ids.is_empty() {
            return selection.select(&self.catalog).map_err(|error| Failure::Usage(error.to_string()));
        }
        Ok(self.blueprints())
    }

    /// Like [`Self::open_beside`], for goals that a training learns and evaluates.
    ///
    /// # Errors
    /// As for [`Self::open_beside`]; also names a blueprint that is held out from training.
    pub(super) fn for_training(named: &[OsString], run: Option<&Path>) -> Result<Self, Failure> {
        let goals = Self::open_beside(named, run)?;
        for id in goals.ids.iter().chain(&goals.own) {
            let goal = find(&goals.catalog, id.as_str())?;
            if goal.split() != Split::Train {
                return Err(Failure::Usage(format!(
                    "--blueprint: {id} is of the split {}, which is held out from training",
                    goal.split()
                )));
            }
            // Compare with the built-in catalog, because a blueprint of the same structure would replace the held-out
            // one.
            if let Some(other) = Catalog::builtin().held_out_like(goal) {
                return Err(Failure::Input(format!(
                    "--blueprint: {id} has the outline of {}, which is held out from training; change its shape",
                    other.id()
                )));
            }
        }
        Ok(goals)
    }

    /// Prints the choices made for blocks, in the named files, that could be oriented in several ways.
    pub(super) fn tell_choices(&self, terminal: &Terminal) {
        for (file, found) in self.inferred.iter().filter(|(_, found)| found.is_a_choice()) {
            terminal.print(&format!("{file}: {found}; `axes` in the file chooses another"));
        }
    }

    /// The settings of a training on the named goals alone; none if the configuration is to choose.
    pub(super) fn settings(&self) -> Vec<Override> {
        if self.ids.is_empty() {
            return Vec::new();
        }
        let ids: Vec<String> = self.ids.iter().map(ToString::to_string).collect();
        let flag = |path: &str, value: toml::Value| Override::flag("--blueprint", path, value);
        vec![
            flag("actor.tasks.filter.blueprints", ids.clone().into()),
            flag("evaluator.selection.splits", vec!["train"].into()),
            flag("evaluator.selection.sizes", vec![2, N_BLOCKS as i64].into()),
            flag("evaluator.selection.blueprints", ids.into()),
        ]
    }

    /// Writes blueprints that the built-in catalog lacks to the run's folder, so that the run can resume without the
    /// original files, and what tells whether they are still the same.
    pub(super) fn keep(&self, run: &RunPaths) -> Result<(), Failure> {
        if self.own.is_empty() {
            return Ok(());
        }
        let text = |goal: &&Blueprint| {
            (format!("{}.toml", goal.id()), goal.to_toml("a goal that this run was given").into_bytes())
        };
        let own: Vec<&Blueprint> = self.own.iter().filter_map(|id| self.catalog.get(id)).collect();
        let structures: BTreeMap<&BlueprintId, String> =
            own.iter().map(|goal| (goal.id(), fingerprint(goal))).collect();
        let structures = serde_json::to_vec_pretty(&structures).map_err(anyhow::Error::from)?;
        let files = own.iter().map(text).chain([(STRUCTURES.to_owned(), structures)]);
        write_files(&run.blueprints(), &files.collect::<Vec<_>>())?;
        Ok(())
    }
}

/// Whether this blueprint has already been named.
///
/// # Errors
/// When two different blueprints share an id, or one structure has two ids: only one of them could be used.
fn is_repeated(before: &[Named], id: &BlueprintId, structure: u64, name: &OsStr) -> Result<bool, Failure> {
    let same = before.iter().find(|other| other.id == *id || other.structure == structure);
    let Some(Named { id: other, structure: its_structure, name: taken }) = same else { return Ok(false) };
    let taken = taken.display();
    let why = match (other == id, *its_structure == structure) {
        (true, true) => return Ok(true),
        (true, false) => format!("the id {id} is taken by {taken}; give one of the two another `id`"),
        (false, _) => format!("{id} is the same structure as {other} of {taken}; name only one of them"),
    };
    Err(Failure::Usage(format!("{}: {why}", name.display())))
}

/// Name of the file, beside a run's blueprints, with the fingerprint of each one's structure. Runs of earlier versions
/// have none.
const STRUCTURES: &str = "structures.json";

fn fingerprint(blueprint: &Blueprint) -> String {
    format!("{:016x}", blueprint.canonical_hash())
}

/// Checks that the blueprints kept with a run have the structures that the run began with.
fn check_unchanged(folder: &Path, kept: &Catalog) -> Result<(), Failure> {
    let path = folder.join(STRUCTURES);
    if !path.exists() {
        return Ok(());
    }
    let known: BTreeMap<String, String> = read_json(&path)?;
    let is_other = |goal: &&Blueprint| known.get(goal.id().as_str()).is_some_and(|known| *known != fingerprint(goal));
    match kept.iter().find(is_other) {
        None => Ok(()),
        Some(goal) => Err(Failure::Checkpoint(anyhow!(
            "{}: {} is not the structure that the run began with: put it back, or start a run with the new one",
            folder.display(),
            goal.id()
        ))),
    }
}

/// Returns the run that this is the folder of, or that has the file or folder.
pub(super) fn run_of(path: &Path) -> Option<RunPaths> {
    path.ancestors().take(5).map(RunPaths::new).find(|run| run.config().exists())
}

/// Finds the blueprint with this id, or else the one with this title.
fn find<'c>(catalog: &'c Catalog, id: &str) -> Result<&'c Blueprint, Failure> {
    let found = id.parse::<BlueprintId>().ok().and_then(|id| catalog.get(&id));
    let titled = || catalog.iter().find(|blueprint| blueprint.title().eq_ignore_ascii_case(id));
    found.or_else(titled).ok_or_else(|| {
        let nearest = nearest(id, catalog.iter().flat_map(|blueprint| [blueprint.id().as_str(), blueprint.title()]));
        let suggestion = suggestion_or(&nearest, "; `lodestone blueprints list` lists them");
        Failure::Input(format!("there is no blueprint `{id}`{suggestion}"))
    })
}

/// Whether a name refers to a file or folder. An id stays an id even if a folder has that name.
pub(super) fn is_path(name: &OsStr) -> bool {
    let id = name.to_str().and_then(|id| id.parse::<BlueprintId>().ok());
    let is_id = || id.is_some_and(|id| Catalog::builtin().get(&id).is_some());
    let bytes = name.as_encoded_bytes();
    bytes.contains(&b'/') || bytes.ends_with(b".toml") || (!is_id() && Path::new(name).exists())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{DEFAULTS, merge};

    /// The text of the built-in blueprint with this id.
    fn text(id: &str) -> String {
        Catalog::builtin().get(&id.parse().unwrap()).unwrap().to_toml("a test")
    }

    fn ids(named: &[&str]) -> Vec<String> {
        let named: Vec<OsString> = named.iter().map(OsString::from).collect();
        let goals = Goals::open_beside(&named, None).unwrap();
        goals.blueprints().iter().map(|blueprint| blueprint.id().to_string()).collect()
    }

    #[test]
    fn a_title_stands_for_an_id() {
        assert_eq!(ids(&["scorpion", "Bull", "16_002"]), ["16_002", "14_003"]);
        let error = find(Catalog::builtin(), "scorpoin").unwrap_err().to_string();
        assert!(error.contains("did you mean `scorpion`?"), "{error}");
    }

    #[test]
    fn files_folders_and_ids_can_be_named() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a.toml"), text("2_003").replace("2_003", "2_900")).unwrap();
        std::fs::write(folder.path().join("b.toml"), text("3_001").replace("3_001", "3_900")).unwrap();
        let own = folder.path().display().to_string();
        assert_eq!(ids(&[]), Vec::<String>::new());
        assert_eq!(ids(&["6_005", "2_003", "6_005"]), ["6_005", "2_003"]);
        assert_eq!(ids(&["6_005", &own]), ["6_005", "2_900", "3_900"]);
        assert_eq!(ids(&[&format!("{own}/b.toml")]), ["3_900"]);
    }

    #[test]
    fn a_run_keeps_the_goals_that_it_was_given() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("my tower.toml");
        let blocks = ["2x1x1", "2x1x1", "1x1x1"].iter().enumerate();
        let blocks = blocks.map(|(z, kind)| format!("{{ type = \"{kind}\", at = [0, 0, {z}] }}")).collect::<Vec<_>>();
        std::fs::write(&file, format!("blocks = [{}]", blocks.join(", "))).unwrap();
        let named = [file.clone().into(), "6_005".into()];
        let goals = Goals::for_training(&named, None).unwrap();
        assert_eq!(goals.inferred.len(), 5);
        let config = merge("base = \"laptop\"", "file", &DEFAULTS, &goals.settings()).unwrap();
        config.clone().checked().unwrap();
        let selected = |catalog: &Catalog| {
            let selected = config.evaluator.selection.select(catalog).unwrap();
            let mut ids: Vec<String> = selected.iter().map(|goal| goal.id().to_string()).collect();
            ids.sort();
            ids
        };
        assert_eq!(selected(&goals.catalog), ["6_005", "my-tower"]);
        assert_eq!(config.actor.tasks.filter.select(&goals.catalog).unwrap().len(), 2);

        let run = RunPaths::new(folder.path().join("run"));
        goals.keep(&run).unwrap();
        std::fs::write(run.config(), config.to_toml()).unwrap();
        std::fs::remove_file(&file).unwrap();
        let resumed = Goals::for_training(&[], Some(run.folder())).unwrap();
        assert_eq!(selected(&resumed.catalog), ["6_005", "my-tower"]);
        assert_eq!((&resumed.catalog, resumed.settings().len()), (&goals.catalog, 0));
        let evaluated = Goals::open_beside(&["my-tower".into()], Some(&run.checkpoints().join("step-1"))).unwrap();
        assert_eq!(evaluated.blueprints().len(), 1);

        let kept = run.blueprints().join("my-tower.toml");
        std::fs::write(&kept, text("3_001").replace("\"3_001\"", "\"my-tower\"")).unwrap();
        let error = Goals::for_training(&[], Some(run.folder())).err().unwrap();
        assert!(matches!(error, Failure::Checkpoint(_)), "{error}");
        assert!(error.to_string().contains("my-tower is not the structure that the run began with"), "{error}");
    }

    #[test]
    fn two_that_share_an_id_or_a_structure_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: String| {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(&path, text).unwrap();
            path.display().to_string()
        };
        let copy = write("copy.toml", text("6_005").replace("\"6_005\"", "\"copy\""));
        let a = write("a/x.toml", text("2_003").replace("\"2_003\"", "\"x\""));
        let b = write("b/x.toml", text("3_001").replace("\"3_001\"", "\"x\""));
        let hiding = write("hiding.toml", text("3_001").replace("\"3_001\"", "\"3_000\""));
        assert_eq!(ids(&[&copy, &copy]), ["copy"]);
        for (named, words) in [
            ([copy.as_str(), "6_005"], "6_005: 6_005 is the same structure as copy of"),
            (["6_005", copy.as_str()], "copy is the same structure as 6_005 of 6_005; name only one"),
            ([a.as_str(), b.as_str()], "the id x is taken by"),
            ([hiding.as_str(), "3_000"], "the id 3_000 is taken by another structure of the catalog"),
            (["3_000", hiding.as_str()], "the id 3_000 is taken by another structure of the catalog"),
            ([hiding.as_str(), "6_005"], "the id 3_000 is taken by another structure of the catalog"),
        ] {
            let named = named.map(OsString::from);
            let message = Goals::open_beside(&named, None).err().unwrap().to_string();
            assert!(message.contains(words), "{message}");
        }
    }

    #[test]
    fn training_refuses_what_is_held_out() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("chair.toml");
        let chair = text("literal_10_000").replace("\"literal_10_000\"", "\"chair\"");
        let copy = chair.replace("\"test-literal\"", "\"train\"");
        std::fs::write(&file, copy).unwrap();
        for (name, words) in [
            (file.display().to_string(), "chair has the outline of "),
            ("validation_7_000".to_owned(), "of the split validation, which is held out"),
            ("6-005".to_owned(), "did you mean `6_005`"),
        ] {
            let message = Goals::for_training(&[name.into()], None).err().unwrap().to_string();
            assert!(message.contains(words), "{message}");
        }
    }
}

//! Reads datasets back with the Arrow crates that wrote them; `python/tests/test_recording.py` reads them with Minari.

use arrow_array::cast::AsArray;
use arrow_array::types::{Float32Type, Float64Type, Int64Type};
use arrow_array::{Array, StructArray};
use arrow_ipc::reader::FileReader;
use blueprints::Catalog;
use evaluator::{EnvironmentConfig, Performance, Performer, perform};
use policy::features::write_features;
use proto::{ActionMode, Observation};
use serde_json::Value;

use super::*;

fn goal() -> &'static Blueprint {
    Catalog::builtin().get(&"3_000".parse().unwrap()).unwrap()
}

/// Runs an episode of the expert.
fn played(environment: &EnvironmentConfig, seed: u64) -> Trajectory {
    let performance = Performance { environment, blueprint: goal(), before: &[], acting: ActionMode::Greedy, seed };
    perform(performance, Performer::Expert, &|| true).unwrap().unwrap()
}

fn begun(root: &Path) -> Result<Writer, DatasetError> {
    let about = About {
        id: "lodestone/expert-v0".parse().unwrap(),
        algorithm: "expert".to_owned(),
        description: "A test.".to_owned(),
        code_permalink: None,
        origin: Origin { lodestone_version: "0", weights_version: 0, n_env_steps: 0, acting: "mode", seed: 1 },
    };
    let (settings, features) = (EnvironmentConfig::default(), FeatureConfig::default());
    let starts = [("scattered", 1.0)].into();
    let world = World { blueprint: vec!["3_000".to_owned()], starts, settings: &settings, features: &features };
    Writer::create(root, about, Spaces::new(&features), &world)
}

fn json_of(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

fn part<'a>(rows: &'a StructArray, name: &str) -> &'a StructArray {
    rows.column_by_name(name).unwrap().as_struct()
}

/// Returns the numbers of a row.
fn floats(table: &StructArray, name: &str, row: usize) -> Vec<f32> {
    let list = table.column_by_name(name).unwrap().as_fixed_size_list().value(row);
    list.as_primitive::<Float32Type>().values().to_vec()
}

#[test]
fn what_is_read_is_what_was_played() {
    let root = tempfile::tempdir().unwrap();
    let mut writer = begun(root.path()).unwrap();
    let short = EnvironmentConfig { episode_steps: 3, ..EnvironmentConfig::default() };
    let episodes = [played(&EnvironmentConfig::default(), 1), played(&short, 2)];
    assert_eq!(episodes.each_ref().map(|episode| episode.status), [Status::Success, Status::TimeLimit]);
    for (seed, episode) in episodes.iter().enumerate() {
        writer.write(episode, goal(), seed as u64).unwrap();
    }
    let data = root.path().join("lodestone/expert-v0/data");
    let head = json_of(&data.join(METADATA));
    let n_steps: usize = episodes.iter().map(|episode| episode.transitions.len()).sum();
    assert_eq!((&head["total_episodes"], &head["total_steps"]), (&json!(2), &json!(n_steps)));
    let spec: Value = serde_json::from_str(head["env_spec"].as_str().unwrap()).unwrap();
    assert_eq!((&spec["id"], &spec["kwargs"]["blueprint"]), (&json!("Lodestone/Assembly-v0"), &json!(["3_000"])));
    for (number, episode) in episodes.iter().enumerate() {
        let folder = data.join(number.to_string());
        let about = json_of(&folder.join(METADATA));
        assert_eq!(about["options"], json!({ "blueprint": "3_000", "start": "scattered" }));
        assert_eq!((&about["seed"], &about["is_success"]), (&json!(number), &json!(number == 0)));
        let mut file = FileReader::try_new(fs::File::open(folder.join("part-0.arrow")).unwrap(), None).unwrap();
        let rows = StructArray::from(file.next().unwrap().unwrap());
        assert!(file.next().is_none());
        check(&rows, episode);
    }
}

fn check(rows: &StructArray, episode: &Trajectory) {
    let n_steps = episode.transitions.len();
    assert_eq!(rows.len(), n_steps + 1);
    let goal = goal().permuted(&episode.task.assignment);
    let scenes = episode.transitions.iter().map(|step| &step.scene).chain([&episode.last_scene]);
    let [n_nodes, n_edges, n_globals] = Spaces::new(&FeatureConfig::default()).lengths();
    for (row, scene) in scenes.enumerate() {
        let (mut nodes, mut edges, mut globals) = (vec![0.0; n_nodes], vec![0.0; n_edges], vec![0.0; n_globals]);
        let seen = Observation { scene, blueprint: &goal, n_steps: row as u16 };
        write_features(&seen, &FeatureConfig::default(), &mut nodes, &mut edges, &mut globals);
        for (name, numbers) in [("nodes", nodes), ("edges", edges), ("globals", globals)] {
            assert_eq!(floats(part(rows, "observations"), name, row), numbers, "{name} of row {row}");
        }
    }
    let rewards = rows.column_by_name("rewards").unwrap().as_primitive::<Float64Type>();
    let flag = |table: &StructArray, name: &str, row| table.column_by_name(name).unwrap().as_boolean().value(row);
    for (row, step) in episode.transitions.iter().enumerate() {
        let is_last = row + 1 == n_steps;
        let (actions, infos) = (part(rows, "actions"), part(rows, "infos"));
        let choices = actions.column_by_name("choices").unwrap().as_fixed_size_list().value(row);
        let blocks = step.action.choices.map(|block| i64::from(u8::from(block.unwrap())));
        assert_eq!(choices.as_primitive::<Int64Type>().values()[..], blocks);
        assert_eq!(
            floats(actions, "moves", row),
            step.action.moves.map(|row| row.map(|x| x.clamp(-1.0, 1.0))).as_flattened()
        );
        assert_eq!(rewards.value(row), f64::from(step.reward.total()));
        let terms = floats(infos, "reward_terms", row + 1);
        assert_eq!((terms[0], terms[4]), (step.reward.connected, step.reward.force));
        let succeeded = is_last && episode.status == Status::Success;
        assert_eq!(flag(rows, "terminations", row), succeeded);
        assert_eq!(flag(rows, "truncations", row), is_last && !succeeded);
        assert_eq!(flag(infos, "is_success", row + 1), succeeded);
    }
}

#[test]
fn a_folder_is_never_written_twice() {
    let root = tempfile::tempdir().unwrap();
    begun(root.path()).unwrap();
    let refused = begun(root.path()).unwrap_err().to_string();
    assert!(refused.contains("expert-v0 exists already") && refused.contains("--name"), "{refused}");
}

#[test]
fn only_whole_episodes_of_the_goal_are_written() {
    let root = tempfile::tempdir().unwrap();
    let mut writer = begun(root.path()).unwrap();
    let whole = played(&EnvironmentConfig::default(), 1);
    let other = Catalog::builtin().get(&"2_000".parse().unwrap()).unwrap();
    let diverged = Trajectory { status: Status::Running, ..whole.clone() };
    let rest = Trajectory { first_step: 1, ..whole.clone() };
    for (trajectory, goal, words) in [
        (&whole, other, "the goal is 3_000, not 2_000"),
        (&diverged, goal(), "the trajectory of 3_000 is no whole episode"),
        (&rest, goal(), "the trajectory of 3_000 is no whole episode"),
    ] {
        assert_eq!(writer.write(trajectory, goal, 0).unwrap_err().to_string(), words);
    }
    assert_eq!(writer.n_episodes(), 0);
}

#[test]
fn names_are_those_that_minari_takes() {
    for good in ["expert-v0", "lodestone/expert-v12", "a/b/my_data-set-v1"] {
        assert_eq!(good.parse::<DatasetId>().unwrap().to_string(), good);
    }
    for bad in ["", "expert", "expert-v", "-v0", "a/x-v0", "../x-v0", "/x-v0", "ab//x-v0", "ab/x-v+1", "ab/x-v0/"] {
        assert_eq!(bad.parse::<DatasetId>(), Err(InvalidDatasetId(bad.to_owned())));
    }
}

//! What the sampler draws, how often, and what a filter refuses.

use rand::SeedableRng;

use super::*;
use crate::tests::toy::id;

fn sampler(config: &TaskConfig) -> TaskSampler {
    TaskSampler::new(config, Catalog::builtin()).unwrap()
}

fn draw(sampler: &TaskSampler, n: usize) -> Vec<Task> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    (0..n).map(|_| sampler.sample(&mut rng)).collect()
}

#[test]
fn filters_select_training_blueprints() {
    let catalog = Catalog::builtin();
    let n_training = catalog.of_split(Split::Train).len();
    assert_eq!(TaskFilter::All.select(catalog).unwrap().len(), n_training);
    let two = TaskFilter::Sizes { min: 2, max: 2 }.select(catalog).unwrap();
    assert!(!two.is_empty() && two.iter().all(|id| id.as_str().starts_with("2_")));
    let named = TaskFilter::Blueprints(vec![id("3_000"), id("2_001"), id("3_000")]);
    assert_eq!(named.select(catalog).unwrap(), [id("2_001"), id("3_000")]);
}

#[test]
fn a_filter_that_selects_nothing_says_why() {
    let table = [
        (TaskFilter::Sizes { min: 17, max: 20 }, "no training blueprint has between 17 and 20 blocks"),
        (TaskFilter::Blueprints(vec![]), "the list of goals is empty"),
        (
            TaskFilter::Blueprints(vec![id("2_000"), id("2_999")]),
            "blueprint 2_999 is not in the training split of the catalog",
        ),
        (
            TaskFilter::Blueprints(vec![id("tallest_14_000")]),
            "blueprint tallest_14_000 is not in the training split of the catalog",
        ),
    ];
    for (filter, message) in table {
        assert_eq!(filter.select(Catalog::builtin()).unwrap_err().to_string(), message);
    }
}

#[test]
fn probabilities_are_restricted_to_the_goals() {
    let filter = TaskFilter::Blueprints(vec![id("2_000"), id("2_001"), id("2_002")]);
    let mut sampler = sampler(&TaskConfig { filter, ..Default::default() });
    let n_of = |sampler: &TaskSampler, name: &str| {
        draw(sampler, 3000).iter().filter(|task| task.blueprint == id(name)).count() as f64
    };
    assert!((n_of(&sampler, "2_001") - 1000.0).abs() < 100.0, "uniform before any probabilities");
    // With 0.1 : 0.3 and 0.6 elsewhere, 2_000 gets a quarter.
    let given = [("2_000", 0.1), ("2_001", 0.3), ("3_000", 0.6)].map(|(name, p)| (id(name), p));
    sampler.follow(&BTreeMap::from(given));
    assert!((n_of(&sampler, "2_000") - 750.0).abs() < 100.0);
    assert_eq!(n_of(&sampler, "2_002"), 0.0);
    sampler.follow(&BTreeMap::from([(id("3_000"), 1.0)]));
    assert!((n_of(&sampler, "2_002") - 1000.0).abs() < 100.0, "uniform when nothing is left");
}

#[test]
fn starts_come_in_the_configured_mix() {
    let config = TaskConfig {
        filter: TaskFilter::Blueprints(vec![id("3_000")]),
        prebuilt_probability: 0.25,
        prebuilt_filter: TaskFilter::Sizes { min: 3, max: 3 },
    };
    let mut n_prebuilt = 0;
    let tasks = draw(&sampler(&config), 4000);
    assert!(tasks.iter().any(|task| task.assignment != tasks[0].assignment));
    for task in tasks {
        match task.start {
            Start::Prebuilt(other) => {
                assert_ne!(other, task.blueprint);
                assert!(other.as_str().starts_with("3_"), "{other} has not three blocks");
                n_prebuilt += 1;
            }
            Start::Scattered => {}
            other => panic!("{other:?}"),
        }
    }
    assert!((n_prebuilt - 1000_i32).abs() < 120);
}

#[test]
fn validation_goals_are_neither_goals_nor_starts() {
    let catalog = Catalog::builtin();
    let config = TaskConfig { prebuilt_probability: 1.0, ..Default::default() };
    let sampler = sampler(&config);
    let split = |id: &BlueprintId| catalog.get(id).unwrap().split();
    assert!(sampler.goals.iter().all(|(goal, _)| split(goal) == Split::Train));
    assert!(sampler.prebuilt.iter().all(|start| split(start) == Split::Train));
    let error = TaskFilter::Blueprints(vec![id("validation_7_000")]).select(catalog).unwrap_err();
    assert_eq!(error, FilterError::NotForTraining(id("validation_7_000")));
}

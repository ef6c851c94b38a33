//! Checks of what every [`Env`] must do, for the tests of any implementation.
//!
//! Each function panics with a description of the failure, like an assertion.

use blueprints::{BlockIdx, Catalog, N_BLOCKS};
use proto::{Action, RewardTerms, Scene, Start, Status, Task};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::config::RewardConfig;
use crate::env::{Env, ResetError, StepResult};
use crate::reset::sample_assignment;
use crate::reward::potential;

/// Steps per checked episode.
const N_STEPS: usize = 25;

/// Runs all checks on environments from `make`. Each must have a time limit of `episode_steps` and rewards as
/// configured in `reward`.
///
/// # Panics
/// If a check fails, or if `catalog` is empty.
pub fn check_all<E: Env>(make: impl Fn() -> E, catalog: &Catalog, reward: &RewardConfig, episode_steps: u16) {
    for seed in 0..3 {
        for task in tasks(catalog, seed) {
            check_repeatable(&make, catalog, &task);
            check_episode(&mut make(), catalog, &task, reward);
        }
    }
    let task = &tasks(catalog, 3)[0];
    check_time_limit(&mut make(), catalog, task, episode_steps);
    check_refusals(&mut make(), catalog, task);
    check_bad_action(&mut make(), catalog, task);
}

/// Returns one task each with a scattered, a prebuilt, and a near-goal start, on goals drawn from the catalog.
fn tasks(catalog: &Catalog, seed: u64) -> Vec<Task> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let blueprints: Vec<_> = catalog.iter().collect();
    assert!(!blueprints.is_empty(), "the catalog is empty");
    let mut draw = || blueprints[rng.random_range(0..blueprints.len())].id().clone();
    let starts = [Start::Scattered, Start::Prebuilt(draw()), Start::NearGoal { undone: 1 }];
    let goals = [draw(), draw(), draw()];
    let task = |(blueprint, start)| Task { blueprint, assignment: sample_assignment(&mut rng), start, seed };
    goals.into_iter().zip(starts).map(task).collect()
}

/// Checks that the same task and actions give the same scenes, rewards, and endings in two fresh environments and in a
/// used one.
fn check_repeatable<E: Env>(make: impl Fn() -> E, catalog: &Catalog, task: &Task) {
    let first = play(&mut make(), catalog, task);
    assert!(first == play(&mut make(), catalog, task), "two fresh environments differ on {task:?}");
    let mut used = make();
    play(&mut used, catalog, &Task { seed: task.seed + 1000, start: Start::Scattered, ..task.clone() });
    assert!(first == play(&mut used, catalog, task), "a reset environment differs from a fresh one on {task:?}");
}

/// Checks that scenes are well-formed, no gripper holds a block after a reset, and the rewards sum to the difference of
/// the potentials.
fn check_episode<E: Env>(env: &mut E, catalog: &Catalog, task: &Task, config: &RewardConfig) {
    env.reset(task, catalog).expect("the task is valid");
    assert_eq!(env.blueprint().id(), &task.blueprint);
    check_scene(env.scene());
    assert!(env.scene().grippers.iter().flatten().all(|g| g.held.is_none()), "a gripper holds before the first step");
    let before = terms(&potential(env.scene(), env.blueprint(), config));
    let mut sum = RewardTerms::default();
    for action in actions(task.seed) {
        let StepResult { reward, status } = env.step(&action);
        if status == Status::Diverged {
            assert_eq!(reward, RewardTerms::default(), "a diverged step has a reward");
            return;
        }
        check_scene(env.scene());
        assert!(reward.total().is_finite(), "reward {reward:?}");
        sum = sum + reward;
    }
    let after = terms(&potential(env.scene(), env.blueprint(), config));
    for (k, sum) in terms(&sum).into_iter().enumerate() {
        let difference = after[k] - before[k];
        assert!((sum - difference).abs() < 1e-3, "term {k}: rewards sum to {sum}, the potential grew by {difference}");
    }
}

/// Checks that an episode without success ends with [`Status::TimeLimit`] at exactly `episode_steps`.
fn check_time_limit<E: Env>(env: &mut E, catalog: &Catalog, task: &Task, episode_steps: u16) {
    env.reset(task, catalog).expect("the task is valid");
    for step in 1..=episode_steps {
        let wanted = if step == episode_steps { Status::TimeLimit } else { Status::Running };
        assert_eq!(env.step(&Action::IDLE).status, wanted, "step {step}");
    }
}

/// Checks that tasks that do not fit are refused and leave the environment unchanged.
fn check_refusals<E: Env>(env: &mut E, catalog: &Catalog, task: &Task) {
    let as_it_is = Task { start: Start::AsItIs, ..task.clone() };
    assert_eq!(env.reset(&as_it_is, catalog), Err(ResetError::NothingToKeep));
    env.reset(task, catalog).expect("the task is valid");
    let before = env.scene().clone();
    let unknown: blueprints::BlueprintId = "nowhere_2_999".parse().expect("it is an id");
    let mut assignment = task.assignment;
    assignment.swap(0, N_BLOCKS - 1);
    for (task, refused) in [
        (Task { blueprint: unknown.clone(), ..task.clone() }, "unknown goal"),
        (Task { start: Start::Prebuilt(unknown), ..task.clone() }, "unknown start"),
        (Task { assignment, ..task.clone() }, "blocks of two types swapped"),
        (Task { start: Start::NearGoal { undone: 0 }, ..task.clone() }, "nothing undone"),
        (Task { start: Start::NearGoal { undone: 16 }, ..task.clone() }, "more undone than there is"),
    ] {
        assert!(env.reset(&task, catalog).is_err(), "accepted: {refused}");
        assert!(*env.scene() == before, "changed by a refused task: {refused}");
    }
    assert_eq!(env.reset(&as_it_is, catalog), Ok(()));
    assert!(env.scene().blocks == before.blocks, "a start as it is moved blocks");
}

/// Checks that a non-finite action ends the episode as diverged, and that the environment can be reset afterward.
fn check_bad_action<E: Env>(env: &mut E, catalog: &Catalog, task: &Task) {
    for bad in [f32::NAN, f32::INFINITY] {
        env.reset(task, catalog).expect("the task is valid");
        let action = Action { choices: [BlockIdx::all().next(), None], moves: [[bad; 6]; N_BLOCKS] };
        assert_eq!(env.step(&action).status, Status::Diverged);
        check_scene(env.scene());
    }
    env.reset(task, catalog).expect("a diverged environment can be reset");
    check_scene(env.scene());
}

fn play<E: Env>(env: &mut E, catalog: &Catalog, task: &Task) -> Vec<(Scene, Option<StepResult>)> {
    env.reset(task, catalog).expect("the task is valid");
    let mut seen = vec![(env.scene().clone(), None)];
    for action in actions(task.seed) {
        let result = env.step(&action);
        seen.push((env.scene().clone(), Some(result)));
    }
    seen
}

fn actions(seed: u64) -> Vec<Action> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let blocks: Vec<_> = BlockIdx::all().collect();
    let mut action = || {
        let choices = std::array::from_fn(|_| Some(blocks[rng.random_range(0..N_BLOCKS)]));
        Action { choices, moves: std::array::from_fn(|_| std::array::from_fn(|_| rng.random_range(-1.5..1.5))) }
    };
    (0..N_STEPS).map(|_| action()).collect()
}

fn check_scene(scene: &Scene) {
    for (pose, speed) in scene.blocks.iter().zip(scene.speeds_mps) {
        assert!(pose.position.iter().all(|x| x.is_finite()), "{pose:?}");
        let norm: f32 = pose.orientation.iter().map(|q| q * q).sum();
        assert!((norm - 1.0).abs() < 1e-3, "{pose:?} is not a rotation");
        assert!(speed >= 0.0, "speed {speed}");
    }
    assert!(scene.joints.iter().all(|j| j.a < j.b), "a connection's blocks are in the wrong order");
    let sorted = scene.joints.windows(2).all(|w| (w[0].a, w[0].b) < (w[1].a, w[1].b));
    assert!(sorted, "connections are not sorted, or two join one pair: {:?}", scene.joints);
}

fn terms(t: &RewardTerms) -> [f32; 5] {
    [t.connected, t.wrong, t.magnets, t.blocks, t.force]
}

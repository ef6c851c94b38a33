//! What every episode must keep to, whatever its task and the world's settings.

use blueprints::{BlockIdx, Catalog, N_BLOCKS};
use environment::config::RewardConfig;
use environment::reward::potential;
use environment::{Env, ResetError, StepResult, World, sample_assignment};
use proto::{Action, RewardTerms, Scene, Start, Status, Task};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

use super::as_array;

/// Steps per checked episode.
const N_STEPS: usize = 25;

/// Runs all checks on worlds from `make`, which have the default rewards and a time limit of `episode_steps`.
pub(super) fn check_all(make: impl Fn() -> World, episode_steps: u16) {
    for task in (0..3).flat_map(tasks) {
        check_repeatable(&make, &task);
        check_episode(&mut make(), &task);
    }
    let task = &tasks(3)[0];
    check_time_limit(&mut make(), task, episode_steps);
    check_refusals(&mut make(), task);
    check_bad_action(&mut make(), task);
}

/// Returns one task each with a scattered, a prebuilt, and a near-goal start, on goals drawn from the catalog.
fn tasks(seed: u64) -> Vec<Task> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let blueprints: Vec<_> = Catalog::builtin().iter().collect();
    let mut draw = || blueprints[rng.random_range(0..blueprints.len())].id().clone();
    let starts = [Start::Scattered, Start::Prebuilt(draw()), Start::NearGoal { undone: 1 }];
    let goals = [draw(), draw(), draw()];
    let task = |(blueprint, start)| Task { blueprint, assignment: sample_assignment(&mut rng), start, seed };
    goals.into_iter().zip(starts).map(task).collect()
}

fn reset(world: &mut World, task: &Task) {
    world.reset(task, Catalog::builtin()).expect("the task is valid");
}

/// Checks that the same task and actions give the same scenes, rewards, and endings in two fresh worlds and in a used
/// one.
fn check_repeatable(make: impl Fn() -> World, task: &Task) {
    let first = play(&mut make(), task);
    assert!(first == play(&mut make(), task), "two fresh worlds differ on {task:?}");
    let mut used = make();
    play(&mut used, &Task { seed: task.seed + 1000, start: Start::Scattered, ..task.clone() });
    assert!(first == play(&mut used, task), "a reset world differs from a fresh one on {task:?}");
}

/// Checks that scenes are well-formed, no gripper holds a block after a reset, and the rewards sum to the difference of
/// the potentials.
fn check_episode(world: &mut World, task: &Task) {
    reset(world, task);
    assert_eq!(world.blueprint().id(), &task.blueprint);
    check_scene(world.scene());
    assert!(world.scene().grippers.iter().flatten().all(|g| g.held.is_none()), "a gripper holds before the first step");
    let terms = |world: &World| as_array(&potential(world.scene(), world.blueprint(), &RewardConfig::default()));
    let before = terms(world);
    let mut sum = RewardTerms::default();
    for action in actions(task.seed) {
        let StepResult { reward, status } = world.step(&action);
        if status == Status::Diverged {
            assert_eq!(reward, RewardTerms::default(), "a diverged step has a reward");
            return;
        }
        check_scene(world.scene());
        assert!(reward.total().is_finite(), "reward {reward:?}");
        sum = sum + reward;
    }
    let after = terms(world);
    for (k, sum) in as_array(&sum).into_iter().enumerate() {
        let difference = after[k] - before[k];
        assert!((sum - difference).abs() < 1e-3, "term {k}: rewards sum to {sum}, the potential grew by {difference}");
    }
}

/// Checks that an episode without success ends with [`Status::TimeLimit`] at exactly `episode_steps`.
fn check_time_limit(world: &mut World, task: &Task, episode_steps: u16) {
    reset(world, task);
    for step in 1..=episode_steps {
        let wanted = if step == episode_steps { Status::TimeLimit } else { Status::Running };
        assert_eq!(world.step(&Action::IDLE).status, wanted, "step {step}");
    }
}

/// Checks that tasks that do not fit are refused and leave the world unchanged.
fn check_refusals(world: &mut World, task: &Task) {
    let as_it_is = Task { start: Start::AsItIs, ..task.clone() };
    assert_eq!(world.reset(&as_it_is, Catalog::builtin()), Err(ResetError::NothingToKeep));
    reset(world, task);
    let before = world.scene().clone();
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
        assert!(world.reset(&task, Catalog::builtin()).is_err(), "accepted: {refused}");
        assert!(*world.scene() == before, "changed by a refused task: {refused}");
    }
    assert_eq!(world.reset(&as_it_is, Catalog::builtin()), Ok(()));
    assert!(world.scene().blocks == before.blocks, "a start as it is moved blocks");
}

/// Checks that a non-finite action ends the episode as diverged, and that the world can be reset afterward.
fn check_bad_action(world: &mut World, task: &Task) {
    for bad in [f32::NAN, f32::INFINITY] {
        reset(world, task);
        let action = Action { choices: [BlockIdx::all().next(), None], moves: [[bad; 6]; N_BLOCKS] };
        assert_eq!(world.step(&action).status, Status::Diverged);
        check_scene(world.scene());
    }
    reset(world, task);
    check_scene(world.scene());
}

fn play(world: &mut World, task: &Task) -> Vec<(Scene, Option<StepResult>)> {
    reset(world, task);
    let mut seen = vec![(world.scene().clone(), None)];
    for action in actions(task.seed) {
        let result = world.step(&action);
        seen.push((world.scene().clone(), Some(result)));
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

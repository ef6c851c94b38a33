//! The expert builds, takes apart, and decides consistently.

use blueprints::{BlueprintId, Catalog};
use proto::{Start, Status, Task, Valid};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

use super::*;
use crate::{Env, World, sample_assignment};

fn id(text: &str) -> BlueprintId {
    text.parse().unwrap()
}

/// Returns a world at the start of an episode and the expert for its goal.
fn begin(config: &Valid<EnvironmentConfig>, goal: &str, start: Start, seed: u64) -> (World, Expert) {
    let mut world = World::new(config);
    let assignment = sample_assignment(&mut ChaCha8Rng::seed_from_u64(seed));
    world.reset(&Task { blueprint: id(goal), assignment, start, seed }, Catalog::builtin()).unwrap();
    let expert = Expert::new(config, world.blueprint()).unwrap();
    (world, expert)
}

/// Runs the expert to the end of the episode and returns whether it succeeds.
fn finish(world: &mut World, expert: &mut Expert) -> bool {
    loop {
        let action = expert.act(world.scene());
        match world.step(&action).status {
            Status::Running => {}
            status => return status == Status::Success,
        }
    }
}

#[test]
fn it_builds_from_scattered_and_from_prebuilt_starts() {
    for (goal, start) in [
        ("2_000", Start::Scattered),
        ("3_001", Start::Scattered),
        ("4_000", Start::Prebuilt(id("4_002"))),
        ("6_005", Start::Scattered),
        ("8_000", Start::Prebuilt(id("6_000"))),
        ("12_000", Start::Scattered),
        ("16_001", Start::Scattered),
    ] {
        let (mut world, mut expert) = begin(&Valid::default(), goal, start.clone(), 3);
        assert!(finish(&mut world, &mut expert), "{goal} from {start:?}");
    }
}

#[test]
fn one_gripper_builds_and_takes_down_what_stands() {
    let config = Valid::new(EnvironmentConfig { n_grippers: 1, ..EnvironmentConfig::default() }).unwrap();
    let mut n_built = 0;
    for (goal, start) in [
        ("2_000", Start::Scattered),
        ("4_000", Start::Scattered),
        ("2_003", Start::Prebuilt(id("2_000"))),
        ("2_004", Start::Prebuilt(id("3_000"))),
    ] {
        let (mut world, mut expert) = begin(&config, goal, start, 3);
        assert_eq!(expert.act(world.scene()).choices[1], None, "there is no second gripper");
        n_built += u32::from(finish(&mut world, &mut expert));
    }
    assert!(n_built >= 3, "{n_built} of 4");
}

#[test]
fn its_actions_are_those_of_a_policy_and_depend_on_the_scene_and_the_blueprint_alone() {
    for (goal, start, seed) in
        [("4_000", Start::Prebuilt(id("6_000")), 1), ("12_000", Start::Scattered, 1), ("6_005", Start::Scattered, 5)]
    {
        let config = Valid::default();
        let (mut world, mut expert) = begin(&config, goal, start, seed);
        loop {
            let action = expert.act(world.scene());
            // An expert that has seen the whole episode and one that sees only this scene act alike.
            let newcomer = Expert::new(&config, world.blueprint()).unwrap().act(world.scene());
            assert_eq!(action, newcomer);
            // There is no null action: every gripper chooses a block, and no entry exceeds the limits.
            assert!(action.choices.iter().all(Option::is_some));
            assert!(action.moves.iter().flatten().all(|x| (-1.0..=1.0).contains(x)));
            if world.step(&action).status != Status::Running {
                break;
            }
        }
    }
}

#[test]
fn it_recovers_from_what_it_did_not_do() {
    // Every other of the first 20 actions is random, which drops and displaces blocks. Then the expert finishes.
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let mut n_built = 0;
    for seed in 0..4 {
        let (mut world, mut expert) = begin(&Valid::default(), "4_000", Start::Scattered, seed);
        for step in 0..20 {
            let mut action = expert.act(world.scene());
            if step % 2 == 1 {
                action.choices = action.choices.map(|_| BlockIdx::try_from(rng.random_range(0..16)).ok());
                action.moves.iter_mut().flatten().for_each(|x| *x = rng.random_range(-1.0..1.0));
            }
            world.step(&action);
        }
        n_built += u32::from(finish(&mut world, &mut expert));
    }
    assert!(n_built >= 3, "{n_built} of 4");
}

#[test]
fn a_way_over_a_block_is_free_and_one_through_it_is_not() {
    let (world, expert) = begin(&Valid::default(), "2_000", Start::Scattered, 1);
    let mut scene = world.scene().clone();
    // Three cubes in a row, 0.3 m apart, and everything else far away.
    for (i, pose) in scene.blocks.iter_mut().enumerate() {
        let x = if i < 3 { 0.3 * i as f32 } else { 5.0 + i as f32 };
        (pose.position, pose.orientation) = ([x, 0.0, 0.05], [0.0, 0.0, 0.0, 1.0]);
    }
    let view = View::new(&scene, &expert.blueprint, expert.assembly.blocks());
    let cube = BlockIdx::try_from(0).unwrap();
    let load = Load::new(&view, cube);
    let from = *view.pose(cube);
    let at = |x: f32, z: f32| Isometry3::from_parts(Translation3::new(x, 0.0, z), UnitQuaternion::identity());
    let limits = &expert.limits;
    let is_free = |from: Isometry3<f32>, to: Isometry3<f32>| load.is_free(&view, &from, |at| limits.toward(at, &to));
    assert!(!is_free(from, at(0.45, 0.05)), "through the second cube");
    assert!(is_free(from, at(0.15, 0.05)), "up to its side");
    assert!(is_free(at(0.0, 0.3), at(0.6, 0.3)), "over both");
    assert!(!is_free(from, at(0.0, 0.0)), "into the ground");
    // To reach the far side, it goes up first.
    let twist = load.go(&view, limits, &at(0.45, 0.05));
    assert!(twist.linear.z > 0.5, "{twist:?}");
}

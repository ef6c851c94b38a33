//! The world through its public interface.

#![allow(clippy::unwrap_used)]

use blueprints::{BlockIdx, Blueprint, Catalog, N_BLOCKS};
use environment::config::{RandomizationConfig, RewardConfig, SuccessConfig};
use environment::reward::potential;
use environment::success::is_success;
use environment::{Arrangement, Env, EnvironmentConfig, Expert, World};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use proto::{Action, Joint, Pose, RewardTerms, Scene, Start, Status, Task, Valid};

mod contract;

fn task(blueprint: &Blueprint, start: Start, seed: u64) -> Task {
    Task { blueprint: blueprint.id().clone(), assignment: BlockIdx::array(|block| block), start, seed }
}

fn world(change: impl Fn(&mut EnvironmentConfig)) -> World {
    let mut config = EnvironmentConfig::default();
    change(&mut config);
    World::new(&Valid::new(config).unwrap())
}

/// Returns a world whose blocks are scattered.
fn scattered(change: impl Fn(&mut EnvironmentConfig), seed: u64) -> World {
    let mut world = world(change);
    let goal = Catalog::builtin().iter().next().unwrap();
    world.reset(&task(goal, Start::Scattered, seed), Catalog::builtin()).unwrap();
    world
}

fn block(index: u8) -> BlockIdx {
    BlockIdx::try_from(index).unwrap()
}

/// Returns the goal scene; unused blocks are far away.
fn goal_scene(blueprint: &Blueprint) -> Scene {
    let pose = |block: BlockIdx| match blueprint.placement(block) {
        Some(p) => Pose { position: p.position_m().into(), orientation: p.rotation.quaternion().coords.into() },
        None => Pose { position: [2.0, 0.3 * block.get() as f32 - 2.0, 0.05], orientation: [0.0, 0.0, 0.0, 1.0] },
    };
    Scene {
        joints: blueprint.links().iter().map(|l| Joint { a: l.a, b: l.b, relative: l.relative }).collect(),
        ..Scene::at_rest(BlockIdx::array(pose))
    }
}

/// Returns the scene turned by `yaw` about z and then shifted.
fn moved(scene: &Scene, yaw: f32, x: f32, y: f32) -> Scene {
    let frame =
        Isometry3::from_parts(Translation3::new(x, y, 0.0), UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw));
    let shift = |pose: &Pose| {
        let rotation = frame.rotation * UnitQuaternion::new_normalize(pose.orientation.into());
        let position = frame.rotation * Vector3::from(pose.position) + frame.translation.vector;
        Pose { position: position.into(), orientation: rotation.coords.into() }
    };
    Scene { blocks: scene.blocks.each_ref().map(shift), ..scene.clone() }
}

fn as_array(t: &RewardTerms) -> [f32; 5] {
    [t.connected, t.wrong, t.magnets, t.blocks, t.force]
}

#[test]
fn the_world_keeps_the_contract() {
    let drawn = RandomizationConfig {
        snap_gap_m: Some([0.01, 0.03]),
        density: Some([0.8, 1.2]),
        transition_delay_steps: Some([0, 2]),
        ..Default::default()
    };
    let same = RandomizationConfig::default;
    for (n_grippers, transition_delay_steps, randomization) in [(2, 0, same()), (1, 2, same()), (2, 0, drawn)] {
        let make = || {
            world(|c| {
                c.n_grippers = n_grippers;
                c.transition_delay_steps = transition_delay_steps;
                c.randomization = randomization.clone();
                c.episode_steps = 30;
            })
        };
        contract::check_all(make, 30);
    }
}

/// The clones are taken while blocks fall, snap, hang together, and sleep, and all go on to the end beside the original.
#[test]
fn a_clone_goes_on_bit_for_bit() {
    let catalog = Catalog::builtin();
    let goal = catalog.get(&"4_000".parse().unwrap()).unwrap();
    for start in [Start::Scattered, Start::Prebuilt("6_000".parse().unwrap()), Start::NearGoal { undone: 2 }] {
        let config = Valid::default();
        let mut worlds = vec![World::new(&config)];
        worlds[0].reset(&task(goal, start, 1), catalog).unwrap();
        let mut expert = Expert::new(&config, worlds[0].blueprint()).unwrap();
        for step in 0..60 {
            if step % 4 == 0 {
                worlds.push(worlds[0].clone());
            }
            let action = if step < 45 { expert.act(worlds[0].scene()) } else { Action::IDLE };
            let results: Vec<_> = worlds.iter_mut().map(|world| world.step(&action)).collect();
            assert!(results.iter().all(|result| *result == results[0]), "step {step}");
            assert!(worlds.iter().all(|world| world.scene() == worlds[0].scene()), "step {step}");
        }
        let as_it_is = task(goal, Start::AsItIs, 2);
        for world in &mut worlds {
            world.reset(&as_it_is, catalog).unwrap();
            world.step(&Action::IDLE);
        }
        assert_eq!(worlds.len(), 16);
        assert!(worlds.iter().all(|world| world.scene() == worlds[0].scene()), "as it is");
    }
}

fn arrangement(scene: &Scene) -> Arrangement {
    Arrangement { poses: scene.blocks, connections: scene.joints.iter().map(|joint| (joint.a, joint.b)).collect() }
}

#[test]
fn what_follows_a_set_scene_depends_on_nothing_before_it() {
    let catalog = Catalog::builtin();
    let goal = catalog.get(&"4_000".parse().unwrap()).unwrap();
    for start in [Start::Scattered, Start::Prebuilt("6_000".parse().unwrap()), Start::NearGoal { undone: 2 }] {
        let config = Valid::default();
        let mut worlds = [World::new(&config), World::new(&config)];
        worlds.iter_mut().for_each(|world| world.reset(&task(goal, start.clone(), 1), catalog).unwrap());
        let mut expert = Expert::new(&config, worlds[0].blueprint()).unwrap();
        for _ in 0..20 {
            let action = expert.act(worlds[0].scene());
            worlds[0].step(&action);
        }
        let scene = worlds[0].scene().clone();
        worlds.iter_mut().for_each(|world| world.set_scene(&arrangement(&scene)).unwrap());
        assert_eq!(worlds[0].scene().joints, scene.joints);
        for step in 0..100 {
            let action = expert.act(worlds[0].scene());
            let results = worlds.each_mut().map(|world| world.step(&action));
            assert!(results[0] == results[1] && worlds[0].scene() == worlds[1].scene(), "step {step}");
            if step == 99 {
                assert_eq!(results[0].status, Status::Success, "{start:?}");
            }
        }
    }
}

#[test]
fn an_illegal_scene_is_refused_by_what_is_wrong() {
    let catalog = Catalog::builtin();
    let goal = catalog.get(&"4_000".parse().unwrap()).unwrap();
    let mut world = world(|_| {});
    world.reset(&task(goal, Start::Prebuilt(goal.id().clone()), 1), catalog).unwrap();
    let (before, Joint { a, b, .. }) = (world.scene().clone(), world.scene().joints[0]);
    let loose = BlockIdx::all().find(|block| !goal.contains(*block)).unwrap();
    let mut refused = |change: &dyn Fn(&mut Arrangement), expected: &str| {
        let mut scene = arrangement(&before);
        change(&mut scene);
        let error = world.set_scene(&scene).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
        assert_eq!(*world.scene(), before);
    };
    let [i, j] = [a, loose].map(|block| block.get());
    refused(&|scene| scene.poses[i].position[0] = f32::NAN, &format!("block {i} is at [NaN"));
    refused(&|scene| scene.poses[i].position[0] = 41.0, "within 40 m of the origin");
    refused(&|scene| scene.poses[i].orientation = [0.5; 4].map(|x| x * 1.1), "expected a unit quaternion");
    refused(&|scene| scene.poses[j].position[2] -= 0.11, &format!("block {j} is 0.1"));
    refused(&|scene| scene.poses[j].position = scene.poses[i].position, &format!("blocks {} and", i.min(j)));
    refused(&|scene| scene.connections.push((a, loose)), "expected two blocks with opposite magnets");
    refused(&|scene| scene.connections.push((a, a)), "expected two blocks with opposite magnets");
    refused(&|scene| scene.connections.push((b, a)), "repeats or contradicts");
}

#[test]
fn the_goal_pose_is_a_success_with_the_full_potential_for_every_blueprint() {
    for blueprint in Catalog::builtin().iter() {
        let scene = goal_scene(blueprint);
        assert!(is_success(&scene, blueprint, &SuccessConfig::default()), "{}", blueprint.id());
        let terms = potential(&scene, blueprint, &RewardConfig::default());
        let n = blueprint.links().len() as f32;
        for (term, wanted) in as_array(&terms).into_iter().zip([n, 0.0, 0.5 * n, 0.5 * n, 0.0]) {
            assert!((term - wanted).abs() < 1e-3 * n, "{}: {terms:?} with {n} pairs", blueprint.id());
        }
        let mut stranger = scene.clone();
        stranger.joints.remove(0);
        assert!(!is_success(&stranger, blueprint, &SuccessConfig::default()), "{} lacks one", blueprint.id());
    }
}

#[test]
fn a_near_goal_start_lacks_what_was_taken_off() {
    for blueprint in Catalog::builtin().iter() {
        let mut world = world(|_| ());
        for undone in 1..blueprint.n_blocks().min(4) as u8 {
            for seed in 0..5 {
                let near = task(blueprint, Start::NearGoal { undone }, seed);
                world.reset(&near, Catalog::builtin()).unwrap();
                let loose =
                    |p: &&blueprints::Placement| world.scene().joints.iter().all(|j| j.a != p.block && j.b != p.block);
                let n_loose = blueprint.placements().iter().filter(loose).count();
                // If a single block remains, it has no connection either.
                let all_but_one = usize::from(undone) + 1 == blueprint.n_blocks();
                assert_eq!(n_loose, usize::from(undone) + usize::from(all_but_one), "{}", blueprint.id());
                assert_ne!(world.step(&Action::IDLE).status, Status::Success);
            }
        }
    }
}

#[test]
fn a_scattered_start_stays_as_it_is() {
    for seed in 0..30 {
        let mut world = scattered(|_| (), seed);
        let before = world.scene().blocks;
        (0..10).for_each(|_| {
            world.step(&Action::IDLE);
        });
        assert!(world.scene().joints.is_empty(), "seed {seed}");
        for (i, (old, new)) in before.iter().zip(&world.scene().blocks).enumerate() {
            let moved = (Vector3::from(old.position) - Vector3::from(new.position)).norm();
            assert!(moved < 0.005, "seed {seed}: block {i} moved by {moved} m");
        }
    }
}

#[test]
fn a_gripper_moves_its_block_at_the_commanded_speed_in_the_blocks_own_frame() {
    let mut world = scattered(|_| (), 4);
    let before = world.scene().blocks[0];
    let rotation = UnitQuaternion::new_normalize(before.orientation.into());
    // Straight up at half of 3 m/s, in the block's frame.
    let up = rotation.inverse() * Vector3::z() * 0.5;
    let mut action = Action::IDLE;
    action.choices[0] = Some(block(0));
    action.moves[0][..3].copy_from_slice(up.as_slice());
    world.step(&action);
    let risen = world.scene().blocks[0].position[2] - before.position[2];
    // 0.15 m less half a percent of damping.
    assert!((risen - 0.15).abs() < 0.003, "{risen} m");
    let gripper = world.scene().grippers[0].unwrap();
    assert_eq!(gripper.held, Some(block(0)));
    assert!((Vector3::from(gripper.linear_velocity) - Vector3::z() * 1.5).norm() < 1e-4);
}

#[test]
fn a_switch_disables_the_gripper_for_the_delay() {
    let mut world = scattered(|c| c.transition_delay_steps = 2, 4);
    let held: Vec<_> = [0, 0, 1, 1, 1, 1]
        .map(|b| {
            world.step(&Action { choices: [Some(block(b)), None], ..Action::IDLE });
            world.scene().grippers[0].unwrap().held.map(u8::from)
        })
        .into();
    assert_eq!(held, [Some(0), Some(0), None, None, Some(1), Some(1)]);
}

#[test]
fn a_single_gripper_world_ignores_the_second_choice() {
    let mut world = scattered(|c| c.n_grippers = 1, 4);
    let before = world.scene().blocks[3].position;
    world.step(&Action { choices: [None, Some(block(3))], moves: [[1.0; 6]; N_BLOCKS] });
    assert_eq!(world.scene().grippers[1], None);
    assert!((Vector3::from(before) - Vector3::from(world.scene().blocks[3].position)).norm() < 0.005);
}

#[test]
fn the_cost_of_a_heavy_contact_is_refunded_when_it_ends() {
    let calm = RewardTerms::default();
    let hit = RewardTerms { force: -0.3, ..RewardTerms::default() };
    let forces = [(&calm, &hit), (&hit, &hit), (&hit, &calm)].map(|(a, b)| environment::reward::reward(a, b).force);
    assert_eq!(forces, [-0.3, 0.0, 0.3]);
}

#[test]
fn a_contact_is_heavy_by_the_density_of_its_episode() {
    let goal = Catalog::builtin().iter().next().unwrap();
    let start = Start::Prebuilt("literal_16_000".parse().unwrap());
    // Drawn in one world, and set in the other.
    let mut worlds =
        [world(|c| c.randomization.density = Some([0.25, 0.25])), world(|c| c.physics.density_kgpm3 *= 0.25)];
    for world in &mut worlds {
        world.reset(&task(goal, start.clone(), 1), Catalog::builtin()).unwrap();
    }
    let mut n_heavy = 0;
    for step in 0..40_u8 {
        // Blocks are lifted, and hit the ground and each other.
        let up = if step % 4 < 2 { 1.0 } else { -1.0 };
        let action =
            Action { choices: [Some(block(step % 16)), Some(block(15 - step % 16))], moves: [[up; 6]; N_BLOCKS] };
        for world in &mut worlds {
            world.step(&action);
        }
        assert!(worlds[0].scene() == worlds[1].scene(), "step {step}");
        n_heavy += u32::from(worlds[0].scene().n_heavy_contacts);
    }
    assert!(n_heavy > 10, "{n_heavy}");
}

#[test]
fn a_shuffled_assignment_permutes_blocks_of_one_type() {
    use rand::SeedableRng;
    let mut rng = rand::rngs::ChaCha8Rng::seed_from_u64(5);
    let inventory = blueprints::Inventory::standard();
    let mut moved = 0;
    for _ in 0..100 {
        let assignment = environment::sample_assignment(&mut rng);
        let mut seen = assignment.to_vec();
        seen.sort_unstable();
        assert!(seen.into_iter().eq(BlockIdx::all()));
        assert!(BlockIdx::all().all(|b| inventory.type_idx(b) == inventory.type_idx(assignment[b.get()])));
        moved += usize::from(assignment[0] != block(0));
    }
    // Three of four draws give slot 0 to another cube.
    assert!((60..90).contains(&moved), "{moved}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn potential_and_success_do_not_depend_on_yaw_and_place(
        goal in 0_usize..1000, yaw in -3.2_f32..3.2, x in -1.0_f32..1.0, y in -1.0_f32..1.0, seed in 0_u64..1000,
        built in any::<bool>(),
    ) {
        let all: Vec<_> = Catalog::builtin().iter().collect();
        let blueprint = all[goal % all.len()];
        let scene = if built {
            goal_scene(blueprint)
        } else {
            let mut world = world(|_| ());
            world.reset(&task(blueprint, Start::Scattered, seed), Catalog::builtin()).unwrap();
            world.scene().clone()
        };
        let shifted = moved(&scene, yaw, x, y);
        let config = RewardConfig::default();
        let (here, there) = (potential(&scene, blueprint, &config), potential(&shifted, blueprint, &config));
        for (a, b) in as_array(&here).into_iter().zip(as_array(&there)) {
            prop_assert!((a - b).abs() < 2e-3 * blueprint.links().len() as f32, "{here:?} {there:?}");
        }
        let success = |s: &Scene| is_success(s, blueprint, &SuccessConfig::default());
        prop_assert_eq!(success(&scene), success(&shifted));
        prop_assert_eq!(success(&scene), built);
    }
}

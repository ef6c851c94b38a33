//! Requirements on the physics, measured on the engine itself.

use blueprints::{BlockIdx, CubeRotation, Inventory, N_BLOCKS, RelativePlacement};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use proto::{Action, Joint, Valid};

use crate::config::EnvironmentConfig;
use crate::engine::{SUBSTEP_S, Velocity};
use crate::reset::Layout;
use crate::world::{N_SUBSTEPS, World};

/// Returns a world with the given blocks at their poses and all others far away on the ground.
fn world_with(config: EnvironmentConfig, placed: &[(BlockIdx, Isometry3<f32>)], joints: Vec<Joint>) -> World {
    let mut poses = BlockIdx::array(|block| {
        let half_height = Inventory::standard().half_extents_m(block)[2];
        let [column, row] = [block.get() % 4, block.get() / 4].map(|i| -3.0 + 0.5 * i as f32);
        Isometry3::translation(column, row, half_height)
    });
    for (block, pose) in placed {
        poses[block.get()] = *pose;
    }
    let mut world = World::new(&Valid::new(config).unwrap());
    world.place(&Layout { poses, joints });
    world
}

fn world(placed: &[(BlockIdx, Isometry3<f32>)], joints: Vec<Joint>) -> World {
    world_with(EnvironmentConfig::default(), placed, joints)
}

fn weightless(placed: &[(BlockIdx, Isometry3<f32>)], joints: Vec<Joint>) -> World {
    let mut config = EnvironmentConfig::default();
    config.physics.gravity_mps2 = 0.0;
    world_with(config, placed, joints)
}

impl World {
    fn run_action(&mut self, action: &Action) {
        self.grippers.begin_step(&mut self.engine, action);
        (0..N_SUBSTEPS).for_each(|_| self.substep());
    }

    /// Returns the maximum distance (m) and angle (rad) of a connected block from its target relative to its neighbor.
    fn worst_joint_error(&self) -> (f32, f32) {
        self.connections.joints().iter().fold((0.0_f32, 0.0_f32), |(distance, angle), joint| {
            let seen = self.engine.pose(joint.a).inv_mul(&self.engine.pose(joint.b));
            let error = (seen.translation.vector - joint.relative.position_m()).norm();
            (distance.max(error), angle.max(seen.rotation.angle_to(&joint.relative.rotation.quaternion())))
        })
    }
}

pub(crate) fn block(index: u8) -> BlockIdx {
    BlockIdx::try_from(index).unwrap()
}

pub(crate) fn at(x: f32, y: f32, z: f32, yaw: f32) -> Isometry3<f32> {
    Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw))
}

fn beside(a: u8, b: u8, offset_half_units: [i32; 3]) -> Joint {
    let relative = RelativePlacement { offset_half_units, rotation: CubeRotation::IDENTITY };
    Joint { a: block(a), b: block(b), relative }
}

#[test]
fn opposite_magnets_at_2_cm_and_8_degrees_snap_and_like_poles_never() {
    // Cubes on the ground with a gap of 2 cm between a +x face and a −x face, and between two +x faces.
    let snaps = |yaw: f32| {
        let placed = [(block(0), at(0.0, 0.0, 0.05, 0.0)), (block(1), at(0.12, 0.0, 0.05, yaw))];
        let mut world = world(&placed, vec![]);
        (0..100).for_each(|_| world.substep());
        let (distance, angle) = world.worst_joint_error();
        assert!(distance < 1e-3 && angle < 5e-3, "the snap left {distance} m and {angle} rad");
        world.connections.joints()
    };
    let eight = 8_f32.to_radians();
    assert_eq!(snaps(eight), [beside(0, 1, [2, 0, 0])]);
    assert_eq!(snaps(std::f32::consts::PI + eight), []);
    assert_eq!(snaps(std::f32::consts::PI), []);
}

#[test]
fn a_connection_breaks_at_the_force_that_the_rule_says() {
    // Two cubes, two 2×1×1, and two 3×1×1 side by side in y share 1, 2, and 3 magnet pairs, so they hold 30, 60, and 90
    // N.
    for (a, b, n_pairs) in [(0, 1, 1), (4, 5, 2), (8, 9, 3)] {
        let holds = |force: f32| {
            let placed = [(block(a), at(0.0, 0.0, 1.0, 0.0)), (block(b), at(0.0, 0.1, 1.0, 0.0))];
            let mut world = weightless(&placed, vec![beside(a, b, [0, 2, 0])]);
            for _ in 0..50 {
                for (puller, sign) in [(a, -1.0), (b, 1.0)] {
                    let impulse = Vector3::y() * (sign * force * SUBSTEP_S);
                    let center = world.engine.pose(block(puller)).translation.vector;
                    world.engine.apply_impulse(block(puller), impulse, center);
                }
                world.substep();
            }
            !world.connections.joints().is_empty()
        };
        let strength = 30.0 * n_pairs as f32;
        assert!(holds(0.95 * strength), "{n_pairs} pairs broke under 95 % of their strength");
        assert!(!holds(1.05 * strength), "{n_pairs} pairs held 105 % of their strength");
    }
}

#[test]
fn a_hanging_block_loads_its_connection_with_its_weight() {
    // A cube of 0.2 kg hangs under a held one: 1.962 N.
    let placed = [(block(0), at(0.0, 0.0, 1.0, 0.0)), (block(1), at(0.0, 0.0, 0.9, 0.0))];
    let mut world = world(&placed, vec![beside(0, 1, [0, 0, -2])]);
    for _ in 0..100 {
        // Only the upper cube is held, so the joint carries the other one.
        world.engine.set_gravity(block(0), false);
        world.engine.set_velocity(block(0), Velocity::default());
        world.engine.substep();
    }
    let (force, torque) = world.engine.joint_load(world.connections.live[0].handle);
    assert!((force - 1.962).abs() < 0.05 && torque < 0.01, "{force} N, {torque} N·m");
}

#[test]
fn a_swung_chain_of_16_blocks_stays_within_5_mm() {
    // All blocks end to end along x, 3.2 m long, held at the first block and then near the middle.
    let cells = |i: usize| Inventory::standard().cells(BlockIdx::all().nth(i).unwrap()).map(i32::from);
    // Centers in half units. Blocks two cells wide are offset by half a cell, so that their magnets meet the next
    // block's.
    let mut centers = vec![[cells(0)[0], 0, 0]];
    for i in 1..N_BLOCKS {
        centers.push([centers[i - 1][0] + cells(i - 1)[0] + cells(i)[0], 1 - cells(i)[1] % 2, 0]);
    }
    for held in [0, 9] {
        let placed: Vec<_> = BlockIdx::all()
            .map(|b| {
                let [x, y, _] = centers[b.get()];
                (b, at((x - centers[held][0]) as f32 * 0.05, y as f32 * 0.05, 1.5, 0.0))
            })
            .collect();
        let between = |i: usize| std::array::from_fn(|axis| centers[i][axis] - centers[i - 1][axis]);
        let joints = (1..N_BLOCKS).map(|i| beside(i as u8 - 1, i as u8, between(i)));
        let mut world = world(&placed, joints.collect());
        assert_eq!(world.connections.joints().len(), N_BLOCKS - 1, "some magnets do not meet");
        let mut action = Action { choices: [Some(block(held as u8)), None], moves: [[0.0; 6]; N_BLOCKS] };
        let mut worst = (0.0_f32, 0.0_f32);
        for step in 0..40 {
            // Turns about z at a quarter of full speed while it moves, both back and forth.
            let sign = if (step / 10) % 2 == 0 { 1.0 } else { -1.0 };
            action.moves[held] = [0.2 * sign, 0.1 * sign, 0.0, 0.0, 0.0, 0.25 * sign];
            world.run_action(&action);
            let (distance, angle) = world.worst_joint_error();
            worst = (worst.0.max(distance), worst.1.max(angle));
        }
        assert_eq!(world.connections.joints().len(), N_BLOCKS - 1, "the chain broke");
        assert!(worst.0 < 0.005 && worst.1 < 0.03, "worst error {} m, {} rad", worst.0, worst.1);
    }
}

#[test]
fn a_sleeping_contact_keeps_its_force_when_substeps_change() {
    // A slab of six cubes weighs 11.8 N.
    let slab = block(14);
    let mut world = world(&[(slab, at(0.0, 0.0, 0.05, 0.0))], vec![]);
    let bears = |world: &World, force_n: f32| {
        let mut bears = false;
        world.engine.for_each_contact(force_n, |blocks| bears |= blocks.contains(&Some(slab)));
        bears
    };
    world.engine.merge(2);
    (0..50).for_each(|_| world.engine.substep());
    assert!(world.engine.is_asleep(slab) && bears(&world, 11.0) && !bears(&world, 12.5));
    // Half as long, with half the impulse for the same force.
    world.engine.merge(1);
    world.engine.substep();
    assert!(world.engine.is_asleep(slab) && bears(&world, 11.0) && !bears(&world, 12.5));
}

#[test]
fn joints_leave_the_solver_only_while_nothing_touches_what_is_carried() {
    // Three cubes in a row, carried around between loose blocks and into the ground.
    let placed = [(0, 0.0, 0.5), (1, 0.1, 0.5), (2, 0.2, 0.5), (3, 0.5, 0.05), (4, -0.3, 0.05), (8, 0.1, 0.05)];
    let placed = placed.map(|(index, x, z)| (block(index), at(x, 0.0, z, 0.0)));
    let mut world = world(&placed, vec![beside(0, 1, [2, 0, 0]), beside(1, 2, [2, 0, 0])]);
    let mut action = Action { choices: [Some(block(1)), None], moves: [[0.0; 6]; N_BLOCKS] };
    let (mut n_free, mut n_touching) = (0, 0);
    for step in 0..200 {
        let phase = 0.3 * step as f32;
        let fast = phase.sin();
        let slow = (0.7 * phase).sin();
        action.moves[1] = [0.3 * fast, 0.3 * slow, -0.3 * (0.4 * phase).sin(), 0.1 * slow, 0.1 * fast, 0.3 * slow];
        world.grippers.begin_step(&mut world.engine, &action);
        for _ in 0..N_SUBSTEPS {
            world.substep();
            let is_carried = |b: Option<BlockIdx>| b.is_some_and(|b| world.connections.same_component(b, block(1)));
            let mut touched = false;
            world.engine.for_each_contact(0.0, |[a, b]| touched |= is_carried(a) != is_carried(b));
            let is_free = world.connections.live.iter().any(|connection| connection.is_spared);
            assert!(!(touched && is_free), "step {step}: a contact has no joints to bear it");
            n_free += usize::from(is_free);
            n_touching += usize::from(touched);
        }
    }
    assert!(n_free > 100 && n_touching > 100, "{n_free} substeps free and {n_touching} touching are too few to tell");
}

#[test]
fn a_snap_adds_no_energy_beyond_the_attraction() {
    let blocks = [block(0), block(1)];
    for (gap, yaw, approach) in
        [(0.029, 0.0, 0.0), (0.02, 0.14, 0.0), (0.035, 0.1, 0.0), (0.035, 0.0, 0.5), (0.02, 0.2, 1.0)]
    {
        let placed = [(block(0), at(0.0, 0.0, 1.0, 0.0)), (block(1), at(0.1 + gap, 0.0, 1.0, yaw))];
        let mut world = weightless(&placed, vec![]);
        let energy_j = |world: &World| blocks.map(|block| world.engine.kinetic_energy_j(block)).iter().sum::<f32>();
        let velocity = Velocity { linear: Vector3::new(-approach, 0.0, 0.0), angular: Vector3::zeros() };
        world.engine.set_velocity(block(1), velocity);
        let before = energy_j(&world);
        // The work of one pair from the gap to contact: ∫ 8 N (1 − x / 4 cm) dx.
        let work = 8.0 * (gap - gap * gap / 0.08);
        let mut most = 0.0_f32;
        for _ in 0..100 {
            world.substep();
            most = most.max(energy_j(&world));
        }
        assert_eq!(world.connections.joints().len(), 1);
        assert!(most <= before + work, "{most} J at the most, {before} J before, {work} J of work");
    }
}

#[test]
fn two_grippers_pull_a_pair_apart() {
    let placed = [(block(0), at(0.0, 0.0, 0.5, 0.0)), (block(1), at(0.1, 0.0, 0.5, 0.0))];
    let mut world = world(&placed, vec![beside(0, 1, [2, 0, 0])]);
    let mut action = Action { choices: [Some(block(0)), Some(block(1))], moves: [[0.0; 6]; N_BLOCKS] };
    // Held still by both grippers, the pair stays where it is.
    (0..10).for_each(|_| world.run_action(&action));
    assert!((world.engine.pose(block(0)).translation.vector - Vector3::new(0.0, 0.0, 0.5)).norm() < 0.002);
    assert_eq!(world.connections.joints().len(), 1);
    action.moves[0][0] = -0.3;
    action.moves[1][0] = 0.3;
    (0..5).for_each(|_| world.run_action(&action));
    assert!(world.connections.joints().is_empty());
    let gap = world.engine.pose(block(1)).translation.x - world.engine.pose(block(0)).translation.x;
    assert!(gap > 0.2, "they are only {gap} m apart");
}

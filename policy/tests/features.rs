//! Feature vectors: hand-worked scenes, and invariances.

#![allow(clippy::unwrap_used)]

use blueprints::{BlockIdx, Blueprint, Catalog, N_BLOCKS, RelativePlacement};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use policy::{FeatureBatch, FeatureConfig, FeatureSizes};
use proptest::prelude::*;
use proto::{Gripper, Joint, Observation, Pose, Scene};

const IDENTITY: [f32; 4] = [0.0, 0.0, 0.0, 1.0];

fn blueprint(k: usize) -> &'static Blueprint {
    let catalog = Catalog::builtin();
    let n = catalog.iter().count();
    catalog.iter().nth(k % n).unwrap()
}

fn pose(position: Vector3<f32>, orientation: UnitQuaternion<f32>) -> Pose {
    Pose { position: position.into(), orientation: orientation.coords.into() }
}

fn quaternion(coordinates: [f32; 4]) -> UnitQuaternion<f32> {
    UnitQuaternion::from_quaternion(Quaternion::from(coordinates))
}

/// Blocks far apart in a row, with idle grippers.
fn row_scene() -> Scene {
    Scene::at_rest(std::array::from_fn(|b| Pose { position: [b as f32, 0.0, 0.05], orientation: IDENTITY }))
}

fn features(scene: &Scene, blueprint: &Blueprint, config: &FeatureConfig) -> FeatureBatch {
    let mut batch = FeatureBatch::new(config);
    batch.push(&Observation { scene, blueprint });
    batch
}

fn edge(batch: &FeatureBatch, sender: BlockIdx, receiver: BlockIdx) -> &[f32] {
    let (s, r) = (sender.get(), receiver.get());
    let k = s * 15 + r - usize::from(r > s);
    &batch.edges[k * batch.sizes.edge..(k + 1) * batch.sizes.edge]
}

fn close(a: &[f32], b: &[f32]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 2e-4)
}

#[test]
fn sizes_are_the_papers_without_extensions() {
    assert_eq!(
        FeatureSizes::new(&FeatureConfig::paper()),
        FeatureSizes { node: 3, edge: 24, global: 50, n_grippers: 2 }
    );
    assert_eq!(
        FeatureSizes::new(&FeatureConfig::default()),
        FeatureSizes { node: 10, edge: 36, global: 50, n_grippers: 2 }
    );
    let single = FeatureConfig { n_grippers: 1, ..FeatureConfig::paper() };
    assert_eq!(FeatureSizes::new(&single), FeatureSizes { node: 3, edge: 24, global: 25, n_grippers: 1 });
}

#[test]
fn nodes_and_globals_of_a_hand_made_scene() {
    let mut scene = row_scene();
    // Block 2 stands on its −x face, so its x axis points up.
    let up = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -std::f32::consts::FRAC_PI_2);
    scene.blocks[2] = pose(Vector3::new(1.0, 2.0, 0.25), up);
    scene.grippers[1] = Some(Gripper {
        held: BlockIdx::try_from(2).ok(),
        orientation: scene.blocks[2].orientation,
        linear_velocity: [0.0, 0.0, 1.5],
        angular_velocity: [0.0, std::f32::consts::PI, 0.0],
    });
    let batch = features(&scene, blueprint(0), &FeatureConfig::default());
    let node = &batch.nodes[2 * 10..3 * 10];
    // Height 0.25 / 0.5; held by gripper 1; up is +x; half extents of a cube 0.05 / 0.2.
    assert!(close(&node[0..6], &[0.5, 0.0, 1.0, 1.0, 0.0, 0.0]), "{node:?}");
    assert!(close(&node[7..10], &[0.25; 3]), "{node:?}");
    let second = &batch.globals[25..50];
    // The world's z is the gripper's x, and y stays y: 1.5 / 3 and π / 2π.
    assert!(close(&second[0..9], &[1.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.5, 0.0]), "{second:?}");
    assert_eq!(second[9..].iter().position(|x| *x == 1.0), Some(2));
    assert!(batch.globals[9..25].iter().all(|x| *x == 0.0), "gripper 0 holds nothing");
}

#[test]
fn a_finished_link_needs_no_move() {
    for k in 0..14 {
        let blueprint = blueprint(k);
        let mut scene = row_scene();
        for p in blueprint.placements() {
            scene.blocks[p.block.get()] = pose(p.position_m(), p.rotation.quaternion());
        }
        let link = blueprint.links()[0];
        scene.joints.push(Joint { a: link.a, b: link.b, relative: link.relative });
        let batch = features(&scene, blueprint, &FeatureConfig::default());
        for (i, j) in [(link.a, link.b), (link.b, link.a)] {
            let edge = edge(&batch, j, i);
            let identity = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
            assert!(close(&edge[0..3], &[0.0; 3]) && close(&edge[9..12], &[0.0; 3]), "{edge:?}");
            assert!(close(&edge[3..9], &identity) && close(&edge[12..18], &identity), "{edge:?}");
            assert!(close(&edge[21..24], &[1.0; 3]), "{edge:?}");
            assert!(close(&edge[24..36], &[0.0; 12]), "{edge:?}");
        }
    }
}

#[test]
fn a_pair_outside_the_blueprint_shows_its_offset_alone() {
    let blueprint = blueprint(0);
    let mut outside = BlockIdx::all().filter(|b| !blueprint.contains(*b));
    let (i, j) = (outside.next().unwrap(), outside.next().unwrap());
    let batch = features(&row_scene(), blueprint, &FeatureConfig::default());
    let mut expected = [0.0; 36];
    expected[18] = (j.get() as f32 - i.get() as f32) / 0.5;
    assert!(close(edge(&batch, j, i), &expected));
}

/// A scene with all blocks at random positions, in random orientations.
fn any_scene() -> impl Strategy<Value = Scene> {
    let pose = (prop::array::uniform3(-1.0_f32..1.0), prop::array::uniform4(-1.0_f32..1.0))
        .prop_filter("not near zero", |(_, q)| q.iter().map(|x| x * x).sum::<f32>() > 0.1)
        .prop_map(|(position, q)| Pose { position, orientation: quaternion(q).coords.into() });
    let velocity = prop::array::uniform3(-3.0_f32..3.0);
    (prop::collection::vec(pose, N_BLOCKS), velocity.clone(), velocity, 0..16_u8).prop_map(
        |(poses, linear, angular, held)| {
            let mut scene = row_scene();
            scene.blocks.copy_from_slice(&poses);
            let gripper = scene.grippers[0].as_mut().unwrap();
            gripper.held = BlockIdx::try_from(held).ok();
            gripper.orientation = poses[usize::from(held)].orientation;
            gripper.linear_velocity = linear;
            gripper.angular_velocity = angular;
            scene
        },
    )
}

proptest! {
    #[test]
    fn features_ignore_yaw_and_horizontal_shift(
        scene in any_scene(),
        yaw in -3.0_f32..3.0,
        shift in prop::array::uniform2(-2.0_f32..2.0),
        k in 0..34_usize,
    ) {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
        let mut moved = scene.clone();
        for block in &mut moved.blocks {
            let position = turn * Vector3::from(block.position) + Vector3::new(shift[0], shift[1], 0.0);
            *block = pose(position, turn * quaternion(block.orientation));
        }
        for gripper in moved.grippers.iter_mut().flatten() {
            gripper.orientation = (turn * quaternion(gripper.orientation)).coords.into();
            gripper.linear_velocity = (turn * Vector3::from(gripper.linear_velocity)).into();
            gripper.angular_velocity = (turn * Vector3::from(gripper.angular_velocity)).into();
        }
        let (a, b) = (
            features(&scene, blueprint(k), &FeatureConfig::default()),
            features(&moved, blueprint(k), &FeatureConfig::default()),
        );
        prop_assert!(close(&a.nodes, &b.nodes));
        prop_assert!(close(&a.globals, &b.globals));
        // Rounding may flip the axis of a turn of almost π, so only shorter rotation vectors are compared.
        for (a, b) in a.edges.chunks(36).zip(b.edges.chunks(36)) {
            prop_assert!(close(&a[..27], &b[..27]));
            let angle = a[30..33].iter().map(|x| x * x).sum::<f32>().sqrt();
            if angle < 0.99 {
                prop_assert!((0..9).all(|k| (a[27 + k] - b[27 + k]).abs() < 5e-3), "{a:?} {b:?}");
            }
        }
    }

    #[test]
    fn the_needed_move_puts_the_receiver_in_place(scene in any_scene(), k in 0..34_usize) {
        let blueprint = blueprint(k);
        let link = blueprint.links()[0];
        let (i, j) = (link.a, link.b);
        let batch = features(&scene, blueprint, &FeatureConfig::default());
        let edge = edge(&batch, j, i);
        let [at_i, at_j] = [i, j].map(|b| scene.blocks[b.get()]);
        let turn = UnitQuaternion::from_scaled_axis(Vector3::from_column_slice(&edge[30..33]) * std::f32::consts::PI);
        let q = quaternion(at_i.orientation);
        let position = Vector3::from(at_i.position) + q * (Vector3::from_column_slice(&edge[24..27]) * 0.5);
        let orientation = q * turn;
        let wanted: RelativePlacement = blueprint.relative(i, j).unwrap();
        let sender = position + orientation * wanted.position_m();
        prop_assert!((sender - Vector3::from(at_j.position)).norm() < 1e-3);
        let angle = (orientation * wanted.rotation.quaternion()).angle_to(&quaternion(at_j.orientation));
        prop_assert!(angle < 1e-2);
    }
}

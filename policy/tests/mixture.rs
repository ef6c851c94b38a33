//! The mixture head: what is proposed, that draws follow their log-probability, and that the kernels, their gradients,
//! and burn agree.

#![allow(clippy::unwrap_used)]

use blueprints::{BlockIdx, Blueprint, Catalog, Inventory, Link, RelativePlacement, Split};
use burn::tensor::Device;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use policy::loss_terms::{self, ActionTensors};
use policy::mixture::{ActionRows, DrawLogits, MixtureDistribution, N_READOUTS, Row};
use policy::proposals::{Kind, Proposals, Slot};
use policy::{
    BatchTensors, Engine, FeatureBatch, FeatureConfig, MoveHead, Network, NetworkConfig, PolicyConfig, parameters,
};
use proto::{Action, ActionMode, Gripper, Joint, Move, Observation, Pose, Scene};
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

/// Reach of a step at full speed: 3 m/s and 2π rad/s for 0.1 s.
const STEP_M: f32 = 0.3;
const STEP_RAD: f32 = 0.2 * std::f32::consts::PI;

fn block(index: usize) -> BlockIdx {
    BlockIdx::try_from(index as u8).unwrap()
}

fn goal(id: &str) -> Blueprint {
    Catalog::builtin().get(&id.parse().unwrap()).unwrap().clone()
}

/// A goal, its first connection, and scattered blocks.
fn begin(id: &str) -> (Blueprint, Link, Scene) {
    let goal = goal(id);
    let link = goal.links()[0];
    (goal, link, scattered())
}

fn orientation(pose: &Pose) -> UnitQuaternion<f32> {
    UnitQuaternion::from_quaternion(Quaternion::from(pose.orientation))
}

/// Blocks on a spiral, all turned the same way, with idle grippers.
fn scattered() -> Scene {
    let turned = UnitQuaternion::from_euler_angles(0.3, -0.2, 0.9);
    let place = |i: usize| {
        let angle = i as f32;
        let radius = 0.5 + 0.1 * i as f32;
        Pose {
            position: [radius * angle.cos(), radius * angle.sin(), 0.1 + 0.02 * i as f32],
            orientation: turned.coords.into(),
        }
    };
    Scene::at_rest(std::array::from_fn(place))
}

/// With one gripper, joins go all the way.
fn with_one_gripper(scene: Scene) -> Scene {
    Scene { grippers: [scene.grippers[0], None], ..scene }
}

/// Puts `i` where the goal wants it relative to `j`, and then `off_m` and `turn` away in its own frame.
fn place(scene: &mut Scene, goal: &Blueprint, i: BlockIdx, j: BlockIdx, off_m: Vector3<f32>, turn: Vector3<f32>) {
    let wanted = goal.relative(j, i).unwrap();
    let of_j = &scene.blocks[j.get()];
    let turned = orientation(of_j) * wanted.rotation.quaternion();
    let at = Vector3::from(of_j.position) + orientation(of_j) * wanted.position_m() - turned * off_m;
    let orientation = turned * UnitQuaternion::from_scaled_axis(-turn);
    scene.blocks[i.get()] = Pose { position: at.into(), orientation: orientation.coords.into() };
}

fn joints<'l>(links: impl IntoIterator<Item = &'l Link>) -> Vec<Joint> {
    links.into_iter().map(|link| Joint { a: link.a, b: link.b, relative: link.relative }).collect()
}

/// Builds the goal around a block, without `missing`.
fn build_about(held: BlockIdx, scene: &mut Scene, goal: &Blueprint, missing: Option<BlockIdx>) {
    let is_there = |block: BlockIdx| Some(block) != missing;
    let blocks = goal.placements().iter().map(|placement| placement.block);
    for block in blocks.filter(|&block| block != held && is_there(block)) {
        place(scene, goal, block, held, Vector3::zeros(), Vector3::zeros());
    }
    scene.joints = joints(goal.links().iter().filter(|link| is_there(link.a) && is_there(link.b)));
}

/// Returns each block of the goal with a single neighbor, and that neighbor.
fn ends(goal: &Blueprint) -> Vec<(BlockIdx, BlockIdx)> {
    let neighbors = |block| {
        let linked = goal.links().iter().flat_map(|link| [(link.a, link.b), (link.b, link.a)]);
        linked.filter(move |(own, _)| *own == block).map(|(_, other)| other).collect::<Vec<_>>()
    };
    let end = |block| if let [neighbor] = neighbors(block)[..] { Some((block, neighbor)) } else { None };
    goal.placements().iter().filter_map(|placement| end(placement.block)).collect()
}

/// Moves a block as the world would in one step without contacts.
fn moved(pose: &Pose, movement: &Move) -> Pose {
    let [x, y, z, a, b, c] = *movement;
    let own = orientation(pose);
    let turn = UnitQuaternion::from_scaled_axis(own * Vector3::new(a, b, c) * STEP_RAD);
    Pose {
        position: (Vector3::from(pose.position) + own * Vector3::new(x, y, z) * STEP_M).into(),
        orientation: (turn * own).coords.into(),
    }
}

fn proposals(scene: &Scene, blueprint: &Blueprint) -> Proposals {
    Proposals::new(&Observation { scene, blueprint })
}

/// Returns the move that is proposed for `i` to join `j`.
fn join(scene: &Scene, goal: &Blueprint, i: BlockIdx, j: BlockIdx) -> Move {
    proposals(scene, goal).get(i, Slot::paired(Kind::Join, j)).unwrap().movement
}

fn kinds(proposals: &Proposals, block: BlockIdx) -> Vec<Kind> {
    proposals.slots(block).iter().map(|slot| slot.kind()).collect()
}

/// Returns the distance and the angle between a block and its place relative to another.
fn error(scene: &Scene, goal: &Blueprint, i: BlockIdx, j: BlockIdx) -> (f32, f32) {
    let wanted = goal.relative(j, i).unwrap();
    let (of_i, of_j) = (&scene.blocks[i.get()], &scene.blocks[j.get()]);
    let at = Vector3::from(of_j.position) + orientation(of_j) * wanted.position_m();
    let turned = orientation(of_j) * wanted.rotation.quaternion();
    ((at - Vector3::from(of_i.position)).norm(), turned.angle_to(&orientation(of_i)))
}

#[test]
fn slots_are_numbered_by_kind_and_partner() {
    assert_eq!(Slot::paired(Kind::Join, block(3)).index(), 3);
    assert_eq!(Slot::paired(Kind::Detach, block(15)).index(), 31);
    assert_eq!(Slot::HOLD.index(), 32);
    assert_eq!(Slot::from_index(33), None);
    for index in 0..33 {
        let slot = Slot::from_index(index).unwrap();
        let again = slot.partner().map_or(Slot::HOLD, |partner| Slot::paired(slot.kind(), partner));
        assert_eq!(slot, again);
    }
}

#[test]
fn a_join_along_the_axis_presses_the_block_into_its_place() {
    let (goal, link, scene) = begin("2_000");
    let mut scene = with_one_gripper(scene);
    // 10 cm off along the normal of the connection, not turned: the funnel is over.
    let normal = link.relative.position_m().normalize();
    place(&mut scene, &goal, link.a, link.b, normal * 0.1, Vector3::zeros());
    let join = join(&scene, &goal, link.a, link.b);
    scene.blocks[link.a.get()] = moved(&scene.blocks[link.a.get()], &join);
    let (distance, angle) = error(&scene, &goal, link.a, link.b);
    // It is meant to go 2 cm too far.
    let way_m = Vector3::from_column_slice(&join[..3]) * STEP_M;
    assert!((way_m - normal * 0.12).norm() < 1e-4 && (distance - 0.02).abs() < 1e-4 && angle < 1e-3, "{way_m}");
}

#[test]
fn a_turned_block_is_turned_on_the_way_and_stays_off_until_then() {
    let (goal, link, mut scene) = begin("2_000");
    place(&mut scene, &goal, link.a, link.b, Vector3::zeros(), Vector3::new(0.0, 0.3, 0.2));
    let alone = join(&with_one_gripper(scene.clone()), &goal, link.a, link.b);
    let mut after = scene.clone();
    after.blocks[link.a.get()] = moved(&scene.blocks[link.a.get()], &alone);
    let (distance, angle) = error(&after, &goal, link.a, link.b);
    assert!(angle < 1e-3, "{angle}");
    // 0.15 m/rad of the turn of 0.36 rad beyond 0.1 rad.
    let turn = Vector3::new(0.0_f32, 0.3, 0.2).norm();
    assert!((distance - 0.15 * (turn - 0.1)).abs() < 1e-3, "{distance}");
    // Half of it, where the partner can come too.
    assert_eq!(join(&scene, &goal, link.a, link.b), alone.map(|x| 0.5 * x));
}

/// Returns how deep the deepest point of a 5 × 5 × 5 grid on `i` is in `j`, m; 0 if none is inside.
fn depth(scene: &Scene, i: BlockIdx, j: BlockIdx) -> f32 {
    let (of_i, of_j) = (&scene.blocks[i.get()], &scene.blocks[j.get()]);
    let half = |block| Vector3::from(Inventory::standard().half_extents_m(block));
    let part = |k: usize| (k % 5) as f32 / 2.0 - 1.0;
    let points = (0..125).map(|k| half(i).component_mul(&Vector3::new(part(k), part(k / 5), part(k / 25))));
    let seen = points.map(|point| {
        let at = Vector3::from(of_i.position) + orientation(of_i) * point;
        let of = orientation(of_j).inverse() * (at - Vector3::from(of_j.position));
        (half(j) - of.abs()).min()
    });
    seen.fold(0.0, f32::max)
}

#[test]
fn a_block_that_must_turn_where_it_touches_its_partner_backs_off() {
    let mut n_touching = 0;
    for goal in Catalog::builtin().of_split(Split::Train).iter().filter(|goal| goal.n_blocks() == 2) {
        let link = goal.links()[0];
        for turn in [[0.0, 0.0, 0.5], [0.0, 0.5, 0.0], [0.5, 0.0, 0.0], [0.4, -0.3, 0.2]] {
            let mut scene = with_one_gripper(scattered());
            scene.blocks[link.b.get()].position[2] = 2.0;
            // In its place but for the turn, so a corner is in the partner.
            place(&mut scene, goal, link.a, link.b, Vector3::zeros(), Vector3::from(turn));
            let join = join(&scene, goal, link.a, link.b);
            n_touching += usize::from(depth(&scene, link.a, link.b) > 0.005);
            scene.blocks[link.a.get()] = moved(&scene.blocks[link.a.get()], &join);
            assert!(depth(&scene, link.a, link.b) < 0.004, "{} {turn:?}", goal.id());
        }
    }
    // Not in all: a turn about the normal of the connection presses nothing.
    assert!(n_touching > 30, "{n_touching}");
}

#[test]
fn the_larger_of_two_pieces_waits_above_the_ground_until_the_smaller_one_is_aligned() {
    let goal = goal("3_000");
    let mut scene = scattered();
    // Two blocks are joined, and the third is to come to one of them.
    let (made, open) = (goal.links()[0], goal.links()[1]);
    place(&mut scene, &goal, made.b, made.a, Vector3::zeros(), Vector3::zeros());
    scene.joints = joints([&made]);
    let is_made = |block: BlockIdx| block == made.a || block == made.b;
    let (large, small) = if is_made(open.a) { (open.a, open.b) } else { (open.b, open.a) };
    // The smaller one comes if its move is the same without the other gripper.
    let joins = |scene: &Scene| {
        let comes = join(scene, &goal, small, large) == join(&with_one_gripper(scene.clone()), &goal, small, large);
        (join(scene, &goal, large, small), comes)
    };
    // Once the block and the place beside it are higher than half a meter, it stays.
    for _ in 0..3 {
        let (waits, comes) = joins(&scene);
        assert!(comes && waits[3..] == [0.0; 3]);
        let before = scene.blocks[large.get()].position;
        scene.blocks[large.get()] = moved(&scene.blocks[large.get()], &waits);
        let after = scene.blocks[large.get()].position;
        assert!((0..2).all(|k| (after[k] - before[k]).abs() < 1e-5) && after[2] >= before[2]);
    }
    let lowest = {
        let own = &scene.blocks[large.get()];
        let place = goal.relative(large, small).unwrap();
        own.position[2].min(own.position[2] + (orientation(own) * place.position_m()).z)
    };
    assert!((lowest - 0.5).abs() < 1e-4, "{lowest}");
    // If both grippers hold what stays, and nobody the smaller one, the larger one goes to it.
    let third = BlockIdx::all().find(|&block| !goal.contains(block)).unwrap();
    let both_held = |other: BlockIdx| {
        let holding = |block| Gripper { held: Some(block), ..scene.grippers[0].unwrap() };
        Scene { grippers: [large, other].map(|block| Some(holding(block))), ..scene.clone() }
    };
    // If they hold the two that are to come together, it rises to make room below.
    let (own, waits) = (&scene.blocks[large.get()], join(&both_held(small), &goal, large, small));
    let risen = Vector3::from(moved(own, &waits).position) - Vector3::from(own.position);
    assert!((risen - Vector3::z() * 0.3).norm() < 1e-5 && waits[3..] == [0.0; 3], "{risen}");
    let mut fetching = both_held(third);
    let before = error(&fetching, &goal, large, small).0;
    fetching.blocks[large.get()] = moved(&fetching.blocks[large.get()], &join(&fetching, &goal, large, small));
    assert!(error(&fetching, &goal, large, small).0 < before - 0.1);

    place(&mut scene, &goal, small, large, Vector3::zeros(), Vector3::zeros());
    let (join, comes) = joins(&scene);
    assert!(!comes && join.iter().all(|x| x.abs() < 0.1));
}

#[test]
fn a_long_piece_that_is_held_turns_until_it_is_level_and_comes_while_it_waits() {
    let goal = goal("validation_13_002");
    let members = || goal.placements().iter().map(|placement| placement.block);
    let held = members().next().unwrap();
    let mut scene = scattered();
    let reach = |scene: &Scene| {
        let at = |block: BlockIdx| Vector3::from(scene.blocks[block.get()].position);
        members().map(|block| at(block) - at(held)).max_by(|a, b| a.norm().total_cmp(&b.norm())).unwrap()
    };
    build_about(held, &mut scene, &goal, None);
    let first = reach(&scene);
    assert!(first.norm() > 0.4 && first.z.abs() > 0.1, "{first}");
    for _ in 0..20 {
        let before = reach(&scene);
        let hold = proposals(&scene, &goal).get(held, Slot::HOLD).unwrap().movement;
        scene.blocks[held.get()] = moved(&scene.blocks[held.get()], &hold);
        build_about(held, &mut scene, &goal, None);
        assert!((reach(&scene) - before).norm() < 0.1 + 1e-3);
    }
    let last = reach(&scene);
    assert!(last.z.abs() < 1e-3 && (last.norm() - first.norm()).abs() < 1e-3, "{last}");
    assert!((scene.blocks[held.get()].position[2] - 0.5).abs() < 1e-4);
    // While it waits for its last block, too, and it comes, but not once that is two steps away.
    let (missing, partner) = ends(&goal)[0];
    scene.blocks[held.get()].orientation = UnitQuaternion::from_euler_angles(0.3, -0.2, 0.9).coords.into();
    build_about(held, &mut scene, &goal, Some(missing));
    for (off_m, comes_m) in [(1.0, 0.2), (0.5, 0.0)] {
        let xy_of_missing = |scene: &Scene| Vector3::from(scene.blocks[missing.get()].position).xy();
        place(&mut scene, &goal, missing, partner, Vector3::zeros(), Vector3::zeros());
        let wanted = xy_of_missing(&scene);
        place(&mut scene, &goal, missing, partner, Vector3::repeat(off_m), Vector3::zeros());
        let toward = (xy_of_missing(&scene) - wanted).normalize();
        let wait = join(&scene, &goal, partner, missing);
        assert_eq!(wait[3..] != [0.0; 3], comes_m > 0.0, "{off_m} m");
        let [before, after] = [scene.blocks[partner.get()], moved(&scene.blocks[partner.get()], &wait)]
            .map(|block| Vector3::from(block.position).xy());
        assert!((after - before - toward * comes_m).norm() < 1e-3, "{off_m} m: {before} {after}");
    }
}

#[test]
fn pieces_that_reach_70_cm_come_while_they_wait() {
    let mut reaches = Vec::new();
    for goal in Catalog::builtin().of_split(Split::Train).into_iter().filter(|goal| goal.links().len() > 3) {
        // A piece that lacks one block at an end, and is held beside the place of that block.
        for (missing, held) in ends(goal) {
            let mut scene = scattered();
            build_about(held, &mut scene, goal, Some(missing));
            place(&mut scene, goal, missing, held, Vector3::repeat(1.0), Vector3::zeros());
            let at = |block: BlockIdx| Vector3::from(scene.blocks[block.get()].position);
            let members = goal.placements().iter().map(|placement| placement.block).filter(|&block| block != missing);
            let reach_m = members.map(|block| (at(block) - at(held)).norm()).fold(0.0, f32::max);
            let after = moved(&scene.blocks[held.get()], &join(&scene, goal, held, missing));
            let comes_m = (Vector3::from(after.position) - at(held)).xy().norm();
            // Less than 20 cm where rising and leveling with it take more than a step.
            let expected = if reach_m >= 0.7 { 0.1..0.201 } else { -1e-3..1e-3 };
            assert!(expected.contains(&comes_m), "{}: {reach_m} m, comes {comes_m} m", goal.id());
            reaches.push(reach_m);
        }
    }
    assert!(reaches.iter().any(|reach| (0.6..0.7).contains(reach)) && reaches.iter().any(|reach| *reach >= 0.7));
}

#[test]
fn far_moves_are_scaled_so_that_shift_and_turn_arrive_together_and_noise_grows_with_the_move() {
    let (goal, link, scene) = begin("2_000");
    let mut scene = with_one_gripper(scene);
    let high = BlockIdx::all().find(|&block| block != link.a && block != link.b).unwrap();
    scene.blocks[high.get()].position[2] = 1.0;
    let found = proposals(&scene, &goal);
    let join = found.get(link.a, Slot::paired(Kind::Join, link.b)).unwrap();
    let most = join.movement.iter().fold(0.0_f32, |most, x| most.max(x.abs()));
    assert!((most - 1.0).abs() < 1e-6);
    assert!((join.noise() - 0.03).abs() < 1e-6);
    let still = found.get(high, Slot::HOLD).unwrap();
    assert!(still.movement == [0.0; 6] && (still.noise() - 0.01).abs() < 1e-6);
}

#[test]
fn what_does_nothing_is_not_proposed_and_wrong_connections_can_be_broken() {
    let (goal, link, mut scene) = begin("3_000");
    let outside = BlockIdx::all().find(|&block| !goal.contains(block)).unwrap();
    assert_eq!(kinds(&proposals(&scene, &goal), outside), [Kind::Hold]);
    let before = kinds(&proposals(&scene, &goal), link.a);
    assert!(before.contains(&Kind::Join) && !before.contains(&Kind::Detach));

    scene.joints = joints([&link]);
    let joined = proposals(&scene, &goal);
    let gone = Kind::PAIRED.map(|kind| Slot::paired(kind, link.b));
    assert!(gone.iter().all(|&slot| joined.get(link.a, slot).is_none()));

    scene.joints[0].relative.offset_half_units = link.relative.offset_half_units.map(|x| x + 2);
    let wrong = proposals(&scene, &goal);
    assert!(wrong.get(link.a, Slot::paired(Kind::Detach, link.b)).is_some());
    // It would pull at the connection, and move the partner along.
    assert!(wrong.get(link.a, Slot::paired(Kind::Join, link.b)).is_none());
    assert_eq!(wrong.relation(link.a, link.b)[7], 1.0);
}

#[test]
fn hold_rises_to_half_a_meter_and_no_higher() {
    let goal = goal("2_000");
    let mut scene = scattered();
    let held = block(5);
    let rises = |scene: &Scene| {
        let hold = proposals(scene, &goal).get(held, Slot::HOLD).unwrap();
        moved(&scene.blocks[held.get()], &hold.movement).position[2]
    };
    scene.blocks[held.get()].position[2] = 0.35;
    assert!((rises(&scene) - 0.5).abs() < 1e-5);
    // At most one step of 0.3 m.
    scene.blocks[held.get()].position[2] = 0.05;
    assert!((rises(&scene) - 0.35).abs() < 1e-5);
    scene.blocks[held.get()].position[2] = 0.8;
    assert!((rises(&scene) - 0.8).abs() < 1e-5);
}

#[test]
fn a_block_that_was_pushed_in_vain_goes_back() {
    let (goal, link, mut scene) = begin("2_000");
    let joined = |scene: &Scene| {
        let own = &scene.blocks[link.a.get()];
        let from = own.position;
        let to = moved(own, &join(scene, &goal, link.a, link.b)).position;
        [0, 1, 2].map(|axis| to[axis] - from[axis])
    };
    let free = joined(&scene);
    scene.grippers[0] = Some(Gripper { held: Some(link.a), linear_velocity: [0.0, -2.0, 0.0], ..Gripper::IDLE });
    scene.speeds_mps[link.a.get()] = 1.9;
    assert_eq!(joined(&scene), free);
    // 0.3 m along (0, 1, ½), whose length is √1.25. At 1.3 m/s, it pushes another held block before it.
    for speed_mps in [0.5, 1.3] {
        scene.speeds_mps[link.a.get()] = speed_mps;
        let back = joined(&scene);
        let expected = [0.0, 0.3 / 1.25_f32.sqrt(), 0.15 / 1.25_f32.sqrt()];
        assert!(back.iter().zip(expected).all(|(x, y)| (x - y).abs() < 1e-5), "{speed_mps} m/s: {back:?}");
    }
    // Slow pushes say nothing.
    scene.grippers[0] = Some(Gripper { held: Some(link.a), linear_velocity: [0.0, -0.05, 0.0], ..Gripper::IDLE });
    scene.speeds_mps[link.a.get()] = 0.0;
    assert_eq!(joined(&scene), free);
}

/// Three blocks near each other, one of the connections made, and one wrong.
fn busy() -> (Blueprint, Scene) {
    let (goal, link, mut scene) = begin("4_000");
    place(&mut scene, &goal, link.b, link.a, Vector3::zeros(), Vector3::zeros());
    scene.joints = joints([&link]);
    let other = goal.links().iter().find(|other| **other != link).unwrap();
    let wrong = RelativePlacement { offset_half_units: [2, 0, 4], ..other.relative };
    scene.joints.push(Joint { a: other.a, b: other.b, relative: wrong });
    scene.joints.sort_by_key(|joint| (joint.a, joint.b));
    scene.grippers[0].as_mut().unwrap().held = Some(link.a);
    (goal, scene)
}

fn numbers(n: usize, scale: f32, rng: &mut ChaCha8Rng) -> Vec<f32> {
    (0..n).map(|_| scale * rng.random_range(-1.0..1.0)).collect()
}

/// The entropy of a choice, from its probabilities.
fn entropy(logits: &[f32]) -> f32 {
    let weights: Vec<f32> = logits.iter().map(|logit| logit.exp()).collect();
    let total: f32 = weights.iter().sum();
    -weights.iter().map(|weight| weight / total * (weight / total).ln()).sum::<f32>()
}

#[test]
fn draws_are_as_frequent_as_their_log_probability_says() {
    let (goal, scene) = busy();
    let found = proposals(&scene, &goal);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut logits = numbers(32, 2.0, &mut rng);
    // Four blocks are left to choose, so that every combination is drawn often enough.
    let allowed: Vec<usize> = goal.placements().iter().map(|placement| placement.block.get()).collect();
    (0..32).filter(|k| !allowed.contains(&(k % 16))).for_each(|k| logits[k] = -1e9);
    let readouts = numbers(16 * N_READOUTS, 1.0, &mut rng);
    let distribution = MixtureDistribution { logits: &logits, readouts: &readouts, proposals: &found };
    let n = 200_000;
    let mut counts = std::collections::BTreeMap::new();
    for _ in 0..n {
        let drawn = distribution.act(ActionMode::Sampled, &mut rng).unwrap();
        let rows = ActionRows::new(&found, &drawn.action.choices, &drawn.slots).unwrap();
        let again = distribution.log_prob(&drawn.action, &drawn.slots, &rows);
        assert!((drawn.log_prob - again).abs() < 1e-4, "{} {again}", drawn.log_prob);
        let Action { choices, moves } = &drawn.action;
        let is_still = |b: BlockIdx| choices.contains(&Some(b)) || moves[b.get()] == [0.0; 6];
        assert!(BlockIdx::all().all(is_still), "only what was chosen moves");
        let entry = counts.entry((drawn.action.choices.map(|b| b.map(u8::from)), drawn.slots)).or_insert((0, again));
        entry.0 += 1;
        assert_eq!(entry.1, again, "the noise does not count");
    }
    let mut total = 0.0;
    for ((_, slots), (count, log_prob)) in &counts {
        let p = f64::from(*log_prob).exp();
        total += p;
        let found = f64::from(*count) / f64::from(n);
        // Five standard errors, and a little for those that are hardly ever drawn.
        assert!((found - p).abs() < 5.0 * (p / f64::from(n)).sqrt() + 2e-5, "{slots:?}: {found} of {p}");
    }
    // Hardly any combination is too rare to be drawn.
    assert!((total - 1.0).abs() < 1e-3, "{total}");
}

#[test]
fn the_greedy_action_is_the_most_probable_at_every_draw() {
    let (goal, scene) = busy();
    let found = proposals(&scene, &goal);
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let logits = numbers(32, 2.0, &mut rng);
    let readouts = numbers(16 * N_READOUTS, 1.0, &mut rng);
    let distribution = MixtureDistribution { logits: &logits, readouts: &readouts, proposals: &found };
    let greedy = distribution.act(ActionMode::Greedy, &mut rng).unwrap();
    let best = (0..16).max_by(|&a, &b| logits[a].total_cmp(&logits[b])).unwrap();
    assert_eq!(greedy.action.choices[0], Some(block(best)));
    let mut row = Row::default();
    row.first_proposal(&found, block(best));
    let mut of_slots = Vec::new();
    row.logits(&readouts, &mut of_slots);
    let best_slot = (0..row.len()).max_by(|&a, &b| of_slots[a].total_cmp(&of_slots[b])).unwrap();
    assert_eq!(greedy.slots[0].map(Slot::index), Some(row.index(best_slot)));
    assert_eq!(greedy.action.moves[best], found.get(block(best), greedy.slots[0].unwrap()).unwrap().movement);
}

#[test]
fn draws_that_a_scene_does_not_offer_are_refused() {
    let (goal, scene) = busy();
    let found = proposals(&scene, &goal);
    let (a, b) = (block(0), block(1));
    let hold = Some(Slot::HOLD);
    let offered =
        |blocks: [Option<BlockIdx>; 2], slots: [Option<Slot>; 2]| ActionRows::new(&found, &blocks, &slots).is_some();
    assert!(offered([Some(a), Some(b)], [hold, hold]));
    assert!(offered([Some(a), Some(a)], [hold, None]));
    assert!(offered([Some(a), None], [hold, None]));
    // Both move one block, so only the first one's proposal counts; and a block with its own partner is none.
    assert!(!offered([Some(a), Some(a)], [hold, hold]));
    assert!(!offered([Some(a), Some(b)], [hold, None]));
    assert!(!offered([Some(a), Some(b)], [None, hold]));
    assert!(!offered([Some(a), None], [hold, hold]));
    assert!(!offered([None, None], [None, None]));
    assert!(!offered([Some(a), Some(b)], [Some(Slot::paired(Kind::Detach, a)), hold]));
}

/// The loss of a few recorded actions and its gradient, on the kernels and on burn.
#[test]
fn kernels_and_burn_agree_on_the_loss_and_on_every_gradient() {
    let network = NetworkConfig { move_head: MoveHead::Mixture, value_hidden: vec![32], ..Default::default() };
    let config = PolicyConfig { network, features: FeatureConfig::paper(), ..Default::default() };
    let device = Device::flex();
    let tracked = device.clone().autodiff();
    let on_burn = Network::init(&config.network, &config.sizes(), 0, &tracked);
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let initial = parameters::flatten(&on_burn);
    let noise = numbers(initial.len(), 0.1, &mut rng);
    let values: Vec<f32> = initial.iter().zip(noise).map(|(p, x)| p + x).collect();
    let on_burn = parameters::load(on_burn, &values).unwrap();
    let mut engine = Engine::new(&config, 0, &device, true);
    engine.load(&values).unwrap();

    const N_DRAWS: usize = 30;
    let (goal, scene) = busy();
    let mut batch = FeatureBatch::of_policy(&config);
    let mut actions = Vec::new();
    for draw in 0..N_DRAWS {
        batch.push(&Observation { scene: &scene, blueprint: &goal });
        let outputs = engine.run(&batch, &[draw]);
        let distribution = MixtureDistribution {
            logits: &outputs.logits,
            readouts: &outputs.readouts,
            proposals: &batch.proposals[draw],
        };
        // With one more draw each time, and the last on one block.
        let mut drawn = distribution.act(ActionMode::Sampled, &mut rng).unwrap();
        if draw == N_DRAWS - 1 {
            drawn.action.choices[1] = drawn.action.choices[0];
            drawn.slots[1] = None;
        }
        let rows = ActionRows::new(&batch.proposals[0], &drawn.action.choices, &drawn.slots).unwrap();
        let log_prob = distribution.log_prob(&drawn.action, &drawn.slots, &rows);
        let [first, second_block, second] = distribution.entropies(&rows);
        assert_eq!(second > 0.0, rows.second.len() > 1, "the last has no second proposal");
        let entropy = [entropy(&outputs.logits[..16]) + second_block, first + second];
        actions.push((drawn.action, drawn.slots, rows, log_prob, entropy));
    }
    assert!(actions.iter().any(|(_, _, rows, ..)| rows.second.len() > 1));
    let order: Vec<usize> = (0..N_DRAWS).rev().collect();
    let draws: Vec<&ActionRows> = order.iter().map(|&k| &actions[k].2).collect();
    let loss = |output: &policy::NetworkOutput| {
        let plain = order.iter().map(|&k| &actions[k].0);
        let drawn = order.iter().map(|&k| (&actions[k].1, &actions[k].2));
        let tensors = ActionTensors::new(plain, 2, &tracked).with_draws(drawn, &tracked);
        let log_prob = loss_terms::log_prob(output, &tensors);
        let entropy = loss_terms::entropy(output, tensors.draws.as_ref());
        for (part, values) in [entropy.blocks.clone(), entropy.moves.clone()].into_iter().enumerate() {
            for (found, &k) in values.into_data().try_to_vec::<f32>().unwrap().iter().zip(&order) {
                let on_slices = actions[k].4[part];
                assert!((found - on_slices).abs() < 1e-4, "part {part}: {found} on tensors, {on_slices} on slices");
            }
        }
        let loss = (log_prob.clone() * 0.7 + entropy.blocks * 0.3 + entropy.moves * 0.2 + output.values.clone()).sum();
        (log_prob.into_data().try_to_vec::<f32>().unwrap(), loss)
    };

    let (output, leaves) = engine.run_tracked(&batch, &order, &draws);
    let (log_probs, total) = loss(&output);
    for (found, &k) in log_probs.iter().zip(&order) {
        assert!((found - actions[k].3).abs() < 1e-4, "{found} on tensors, {} on slices", actions[k].3);
    }
    let gradient = engine.gradient(leaves, &total, &draws, Vec::new());

    let mut output = on_burn.forward(&BatchTensors::new(&batch.select(&order), &tracked));
    output.draws = output.readouts.as_ref().map(|readouts| DrawLogits::new(&draws, readouts));
    let (expected, total) = loss(&output);
    log_probs.iter().zip(&expected).for_each(|(a, b)| assert!((a - b).abs() < 1e-4, "{a} {b}"));
    let expected = parameters::flatten_gradients(&on_burn, &mut total.backward());
    for (spec, span) in parameters::spans(on_burn.table()) {
        let largest = expected[span.clone()].iter().fold(1e-6_f32, |most, x| most.max(x.abs()));
        for (found, expected) in gradient[span.clone()].iter().zip(&expected[span]) {
            assert!((found - expected).abs() < 5e-5 * largest, "{}: {found} {expected}", spec.name);
        }
    }
}

//! Each decoding rule has a message that breaks only that rule; the error names the field and the value.

use prost::Message;

use super::samples;
use crate::codec::*;
use crate::{BehaviorPolicy, Disturbance, RewardTerms, Start, Status, Trajectory, Weights, wire};

/// Breaks a rule that the plain type can also break.
#[track_caller]
fn check(change: impl Fn(&mut Trajectory), message: &str) {
    let mut trajectory = samples::successful("actor-1", 1);
    change(&mut trajectory);
    let error = decode_trajectory(&encode_trajectory(&trajectory)).unwrap_err();
    assert_eq!(error.to_string(), message);
}

/// Breaks a rule that only the wire type can break.
#[track_caller]
fn check_wire(change: impl Fn(&mut wire::Trajectory), message: &str) {
    let bytes = encode_trajectory(&samples::successful("actor-1", 1));
    let mut trajectory = wire::Trajectory::decode(bytes.as_slice()).unwrap();
    change(&mut trajectory);
    let error = decode_trajectory(&trajectory.encode_to_vec()).unwrap_err();
    assert_eq!(error.to_string(), message);
}

fn first_scene(trajectory: &mut wire::Trajectory) -> &mut wire::Scene {
    trajectory.transitions[0].scene.as_mut().unwrap()
}

fn first_joint(trajectory: &mut wire::Trajectory) -> &mut wire::Joint {
    &mut first_scene(trajectory).joints[0]
}

fn task(trajectory: &mut wire::Trajectory) -> &mut wire::Task {
    trajectory.task.as_mut().unwrap()
}

#[test]
fn header_alone_names_the_actor() {
    let bytes = encode_trajectory(&samples::successful("actor-1", 1));
    assert_eq!(trajectory_actor(&bytes[..TRAJECTORY_HEADER_BYTES]).unwrap(), "actor-1");
    let name = "a".repeat(64);
    let bytes = encode_trajectory(&samples::successful(&name, 1));
    assert_eq!(trajectory_actor(&bytes[..TRAJECTORY_HEADER_BYTES]).unwrap(), name);
    let mut other = wire::Trajectory::decode(bytes.as_slice()).unwrap();
    other.protocol_version = 77;
    let of = |bytes: &[u8]| trajectory_actor(bytes).unwrap_err().to_string();
    assert!(of(&other.encode_to_vec()).contains("version 77"), "{}", of(&other.encode_to_vec()));
    assert_eq!(of(b""), "protocol_version is missing");
    assert_eq!(of(&[0; 96]), "not a lodestone.v1.Trajectory: failed to decode Protobuf message: invalid tag value: 0");
    assert_eq!(of(&bytes[..40]), "actor is missing");
    for wrong in [&b"garbage"[..], b"{}", &[0xff; 96], &[0x12; 96]] {
        assert!(!of(wrong).is_empty());
    }
}

/// Changes a trajectory to another valid one.
#[track_caller]
fn accept(change: impl Fn(&mut Trajectory)) {
    let mut trajectory = samples::successful("actor-1", 1);
    change(&mut trajectory);
    assert_eq!(decode_trajectory(&encode_trajectory(&trajectory)).unwrap(), trajectory);
}

#[test]
fn the_last_valid_values_are_accepted() {
    accept(|t| (t.epoch, t.seq, t.weights_version.0, t.settings_hash, t.task.seed) = (u64::MAX, 0, u64::MAX, 0, 0));
    accept(|t| t.actor = "z9--".repeat(16).parse().unwrap());
    accept(|t| t.transitions[0].behavior_log_prob = -1e6);
    accept(|t| t.transitions[0].reward = RewardTerms { connected: 1e6, force: -1e6, ..RewardTerms::default() });
    accept(|t| t.transitions[0].action.moves = [[-1e6, 1e6, 0.0, -0.0, f32::MIN_POSITIVE, 1e6]; 16]);
    accept(|t| t.transitions[0].action.choices = [Some(samples::block(15)); 2]);
    accept(|t| t.transitions[0].proposals = [Some(0), Some(255)]);
    accept(|t| t.last_scene.blocks[0].position = [1e6, -1e6, 0.0]);
    accept(|t| t.last_scene.blocks[15].orientation = [0.0, 0.0, -1.0009, 0.0]);
    accept(|t| t.last_scene.speeds_mps = [1e6; 16]);
    accept(|t| t.last_scene.n_heavy_contacts = 255);
    accept(|t| t.last_scene.joints.clear());
    accept(|t| t.last_scene.joints[2].relative.offset_half_units = [-8, 0, 8]);
    accept(|t| {
        let gripper = t.last_scene.grippers[0].as_mut().unwrap();
        (gripper.held, gripper.linear_velocity, gripper.angular_velocity) =
            (Some(samples::block(15)), [1e6; 3], [-1e6; 3]);
    });
    accept(|t| {
        t.transitions[0].disturbance = Disturbance::new(samples::block(15), [2.0, -2.0, 0.0], [5.0, -5.0, 0.0]).ok();
    });
    for start in [Start::Scattered, Start::AsItIs, Start::NearGoal { undone: 1 }, Start::NearGoal { undone: 255 }] {
        accept(|t| t.task.start = start.clone());
    }
    accept(|t| t.behavior_policy = BehaviorPolicy::Greedy);
    for success in [false, true] {
        accept(|t| {
            t.status = Status::TimeLimit;
            t.episode_stats.as_mut().unwrap().success = success;
        });
    }
    accept(|t| {
        t.transitions = vec![t.transitions[0].clone(); 1000];
        t.first_step = u16::MAX - 1000;
        t.episode_stats.as_mut().unwrap().n_steps = u16::MAX;
    });
}

#[test]
fn invalid_numbers_are_refused() {
    let sane = "expected a number in −1e6..=1e6";
    check(|t| t.transitions[0].behavior_log_prob = f32::NAN, &format!("transition.behavior_log_prob is NaN, {sane}"));
    check(|t| t.transitions[0].reward.wrong = f32::INFINITY, &format!("reward.wrong is inf, {sane}"));
    check(|t| t.transitions[0].action.moves[15][5] = 2e6, &format!("action.moves is 2000000, {sane}"));
    check(|t| t.last_scene.blocks[3].position[2] = f32::NAN, &format!("scene.poses is NaN, {sane}"));
    check(|t| t.last_scene.speeds_mps[0] = -1.0, "scene.speeds is -1, expected a number in 0..=1e6");
    check_wire(|t| t.behavior_policy = 3, "behavior_policy is 3, expected sampled, greedy or expert");
    let long = "scene.poses is a quaternion of norm 1.1, expected a norm within 1e-3 of 1";
    check(|t| t.last_scene.blocks[9].orientation = [1.1, 0.0, 0.0, 0.0], long);
}

#[test]
fn wrong_lengths_are_refused() {
    check(|t| t.transitions.clear(), "transitions is 0 steps, expected 1 to 1000 steps");
    let too_many = "transitions is more than 1000, expected 1 to 1000 steps";
    check(|t| t.transitions = vec![t.transitions[0].clone(); 1001], too_many);
    // They are counted before they are parsed: two bytes for each empty one would take hundreds of bytes in memory.
    let transitions = [0x42, 0x00].repeat(MAX_TRAJECTORY_BYTES / 2);
    assert_eq!(decode_trajectory(&transitions).unwrap_err().to_string(), too_many);
    check_wire(|t| first_scene(t).poses.truncate(111), "scene.poses is 111 values, expected 112 values");
    check_wire(|t| first_scene(t).speeds.push(0.0), "scene.speeds is 17 values, expected 16 values");
    check_wire(|t| first_joint(t).offset.clear(), "joint.offset is 0 values, expected 3 values");
    check_wire(|t| task(t).assignment.truncate(15), "task.assignment is 15 values, expected 16 values");
}

#[test]
fn invalid_scenes_are_refused() {
    check(
        |t| t.last_scene.joints.swap(0, 1),
        "scene.joints is (0, 5) before (0, 4), expected block pairs in rising order, each once",
    );
    check_wire(|t| first_joint(t).b = 16, "joint.b is 16, expected a block index in 0..16");
    check_wire(|t| first_joint(t).b = 0, "joint.b is 0, expected a block index above joint.a");
    check_wire(|t| first_joint(t).offset[1] = -9, "joint.offset is -9, expected a number in −8..=8");
    check_wire(|t| first_joint(t).rotation = 24, "joint.rotation is 24, expected a number in 0..24");
    check_wire(
        |t| first_scene(t).n_heavy_contacts = 256,
        "scene.n_heavy_contacts is 256, expected a number in 0..=255",
    );
    check_wire(|t| first_scene(t).gripper_0 = None, "scene.gripper_0 is missing");
    check(
        |t| t.last_scene.grippers[1] = None,
        "scene.grippers is both grippers, expected the same grippers in every scene",
    );
    check(
        |t| t.transitions[0].action.choices[1] = None,
        "action.choice is gripper 0 alone, expected a choice for exactly the grippers of the world",
    );
}

#[test]
fn disturbances_beyond_all_bounds_are_refused() {
    let disturb = |block, displacement: &[f32], push: &[f32], message: &str| {
        let disturbance = wire::Disturbance { block, displacement: displacement.into(), push: push.into() };
        check_wire(|t| t.transitions[0].disturbance = Some(disturbance.clone()), message);
    };
    disturb(16, &[1.0; 3], &[0.0; 3], "disturbance.block is 16, expected a block index in 0..16");
    disturb(3, &[1.0; 2], &[0.0; 3], "disturbance.displacement is 2 values, expected 3 values");
    disturb(3, &[0.0; 3], &[f32::NAN; 3], "disturbance.push is NaN, expected a number in −1e6..=1e6");
    let bounds = "expected at most 2 m and 5 m/s, and not nothing";
    for [displacement, push] in [[[2.1, 0.0, 0.0], [0.0; 3]], [[0.0; 3], [0.0, -5.1, 0.0]], [[0.0; 3], [0.0; 3]]] {
        let numbers = format!("moved by {displacement:?} m and pushed by {push:?} m/s, but the most along an axis");
        let quoted: String = numbers.chars().take(80).collect();
        disturb(3, &displacement, &push, &format!("disturbance is {quoted}, {bounds}"));
    }
}

#[test]
fn inconsistent_endings_are_refused() {
    let endings = "expected running, success or time limit";
    check(|t| t.status = Status::Diverged, &format!("status is 0, {endings}"));
    check_wire(|t| t.status = 9, &format!("status is 9, {endings}"));
    check(|t| t.episode_stats = None, "episode_stats is missing");
    check(|t| t.status = Status::Running, "episode_stats is present, expected none before the episode's end");
    check(
        |t| t.episode_stats.as_mut().unwrap().success = false,
        "episode_stats.success is false, expected true when the status is success",
    );
    check(|t| t.first_step = 1, "episode_stats.n_steps is 42, expected first_step plus the number of transitions");
}

#[test]
fn invalid_names_are_refused() {
    let actor = "expected 1 to 64 of a-z, 0-9 and -";
    check_wire(|t| t.actor.clear(), &format!("actor is , {actor}"));
    check_wire(|t| t.actor = "A/b".into(), &format!("actor is A/b, {actor}"));
    check_wire(|t| t.actor = "x".repeat(1000), &format!("actor is {}, {actor}", "x".repeat(80)));
    check_wire(
        |t| task(t).blueprint = "no such id!".into(),
        "task.blueprint is no such id!, expected the id of a blueprint",
    );
    check_wire(|t| task(t).start = None, "task.start is missing");
    check(|t| t.task.start = Start::NearGoal { undone: 0 }, "task.start.undone is 0, expected a number in 1..=255");
    check(
        |t| t.task.assignment[2] = samples::block(3),
        "task.assignment is block 3 twice, expected a permutation of 0..16",
    );
    check(
        |t| t.task.assignment.swap(0, 15),
        "task.assignment is block 15 for block 0, expected a block of the same type",
    );
}

#[test]
fn incomplete_messages_and_other_versions_are_refused() {
    let version = |found: u32| {
        format!(
            "it has protocol version {found}, and this process speaks version 2: run one version of Lodestone in all \
             processes"
        )
    };
    check_wire(|t| t.protocol_version = 1, &version(1));
    check_wire(|t| t.protocol_version = 3, &version(3));
    check_wire(|t| t.last_scene = None, "last_scene is missing");
    let error = decode_trajectory(&vec![0; MAX_TRAJECTORY_BYTES + 1]).unwrap_err().to_string();
    assert_eq!(error, "Trajectory of 8388609 bytes is larger than the limit of 8388608 bytes");
    let error = decode_trajectory(b"\xff\xff").unwrap_err().to_string();
    assert!(error.starts_with("not a lodestone.v1.Trajectory: "), "{error}");
    assert_eq!(decode_ack(&[]).unwrap_err().to_string(), version(0));
    assert_eq!(decode_notice(&[]).unwrap_err().to_string(), version(0));
    assert_eq!(decode_refusal(&[8, 1]).unwrap_err().to_string(), version(1));
    assert_eq!(decode_refusal(&[8, 2]).unwrap_err().to_string(), "refusal.reason is 0, expected a known reason");
}

#[test]
fn a_changed_recording_is_refused() {
    let trajectory = samples::of_expert("actor-1", 3);
    let bytes = encode_recording(&trajectory);
    assert_eq!(decode_recording(&bytes).unwrap(), trajectory);
    for i in 0..bytes.len() {
        for mask in [0x01, 0x03, 0x80, 0xff] {
            let mut changed = bytes.clone();
            changed[i] ^= mask;
            assert!(decode_recording(&changed).is_err(), "byte {i} ^ {mask}");
        }
        assert!(decode_recording(&bytes[..i]).is_err(), "the first {i} bytes");
    }
    let missing = decode_recording(&encode_trajectory(&trajectory)).unwrap_err().to_string();
    assert_eq!(missing, "checksum is missing");
}

#[test]
fn a_recording_of_version_1_is_read_without_a_checksum() {
    let trajectory = samples::successful("actor-1", 3);
    let mut message = wire::Trajectory::decode(encode_trajectory(&trajectory).as_slice()).unwrap();
    message.protocol_version = 1;
    assert_eq!(decode_recording(&message.encode_to_vec()).unwrap(), trajectory);
    message.protocol_version = 3;
    assert!(decode_recording(&message.encode_to_vec()).is_err());
}

#[test]
fn invalid_weights_are_refused() {
    #[track_caller]
    fn check(change: impl Fn(&mut Weights), message: &str) {
        let mut weights = samples::weights(1);
        change(&mut weights);
        assert_eq!(decode_weights(encode_weights(&weights, 1).into()).unwrap_err().to_string(), message);
    }
    check(|w| w.parameters.clear(), "parameters is 0 values, expected 1 to 25165824 values");
    check(|w| w.parameters[2] = f32::NEG_INFINITY, "parameters is -inf, expected a number in −1e6..=1e6");
    check(|w| w.parameters[2] = 2e6, "parameters is 2000000, expected a number in −1e6..=1e6");
    check(|w| w.normalization.feature_std[0].push(1.0), "normalization.std is 3 values, expected as many as the means");
    check(|w| w.normalization.feature_std[0][1] = 0.0, "normalization.std is 0, expected a finite number above 0");
    check(|w| w.normalization.value_std = f32::NAN, "normalization.value_std is NaN, expected a finite number above 0");
    let mut wire = wire::Weights::decode(encode_weights(&samples::weights(1), 1).as_slice()).unwrap();
    wire.settings = "b = 1\na = 2\n".to_owned();
    let error = decode_weights(wire.encode_to_vec().into()).unwrap_err().to_string();
    assert_eq!(error, "settings is 12 bytes, expected lines `key = value`, sorted by key");
    check(|w| w.task_probabilities.clear(), "task_probabilities is a sum of 0, expected a sum of 1");
    check(
        |w| *w.task_probabilities.values_mut().next().unwrap() = -0.5,
        "task_probabilities.probability is -0.5, expected a number in 0..=1",
    );
}

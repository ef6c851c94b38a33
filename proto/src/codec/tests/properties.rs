//! Every value round-trips; all other bytes return an error, never a panic.

use blueprints::{CubeRotation, Inventory, N_BLOCKS, RelativePlacement};
use proptest::prelude::*;

use super::samples;
use crate::codec::*;
use crate::*;

fn array<const N: usize>(range: std::ops::Range<f32>) -> impl Strategy<Value = [f32; N]> {
    prop::collection::vec(range, N).prop_map(|v| v.try_into().unwrap())
}

fn orientation() -> impl Strategy<Value = [f32; 4]> {
    array::<4>(-1.0..1.0).prop_filter_map("long enough to be normalized", |q| {
        let norm = q.iter().map(|x| x * x).sum::<f32>().sqrt();
        (norm > 0.1).then(|| q.map(|x| x / norm))
    })
}

fn gripper() -> impl Strategy<Value = Gripper> {
    (prop::option::of(0..16u8), orientation(), array(-3.0..3.0), array(-7.0..7.0)).prop_map(
        |(held, orientation, linear_velocity, angular_velocity)| Gripper {
            held: held.map(samples::block),
            orientation,
            linear_velocity,
            angular_velocity,
        },
    )
}

fn joints() -> impl Strategy<Value = Vec<Joint>> {
    let joint = (0..15u8, any::<prop::sample::Index>(), prop::array::uniform3(-8..=8i32), 0..24u8);
    let joint = joint.prop_map(|(a, b, offset_half_units, rotation)| Joint {
        a: samples::block(a),
        b: samples::block(a + 1 + b.index(15 - usize::from(a)) as u8),
        relative: RelativePlacement { offset_half_units, rotation: CubeRotation::try_from(rotation).unwrap() },
    });
    prop::collection::vec(joint, 0..20).prop_map(|mut joints| {
        joints.sort();
        joints.dedup_by_key(|joint| (joint.a, joint.b));
        joints
    })
}

fn scene(two_grippers: bool) -> impl Strategy<Value = Scene> {
    let pose = (array(-5.0..5.0), orientation()).prop_map(|(position, orientation)| Pose { position, orientation });
    let poses = prop::collection::vec(pose, N_BLOCKS);
    (poses, array(0.0..9.0), joints(), gripper(), gripper(), any::<u8>()).prop_map(
        move |(blocks, speeds_mps, joints, first, second, n_heavy_contacts)| Scene {
            blocks: blocks.try_into().unwrap(),
            speeds_mps,
            joints,
            grippers: [Some(first), two_grippers.then_some(second)],
            n_heavy_contacts,
        },
    )
}

fn reward() -> impl Strategy<Value = RewardTerms> {
    array::<5>(-50.0..50.0).prop_map(|[connected, wrong, magnets, blocks, force]| RewardTerms {
        connected,
        wrong,
        magnets,
        blocks,
        force,
    })
}

fn transition(two_grippers: bool) -> impl Strategy<Value = Transition> {
    let moves = prop::collection::vec(array::<6>(-4.0..4.0), N_BLOCKS).prop_map(|m| m.try_into().unwrap());
    (scene(two_grippers), 0..16u8, 0..16u8, moves, -90.0..90.0f32, reward(), prop::option::of(disturbance())).prop_map(
        move |(scene, first, second, moves, behavior_log_prob, reward, disturbance)| Transition {
            scene,
            action: Action {
                choices: [Some(samples::block(first)), two_grippers.then(|| samples::block(second))],
                moves,
            },
            proposals: [None, Some(50)],
            behavior_log_prob,
            reward,
            disturbance,
        },
    )
}

fn disturbance() -> impl Strategy<Value = Disturbance> {
    (0..16u8, array::<3>(-2.0..2.0), array::<3>(-5.0..5.0))
        .prop_filter_map("it changes nothing", |(block, by, push)| {
            Disturbance::new(samples::block(block), by, push).ok()
        })
}

fn task() -> impl Strategy<Value = Task> {
    let start = prop_oneof![
        Just(Start::Scattered),
        Just(Start::AsItIs),
        Just(Start::Prebuilt("4_002".parse().unwrap())),
        (1..=255u8).prop_map(|undone| Start::NearGoal { undone }),
    ];
    let swaps = prop::collection::vec((0..16u8, any::<prop::sample::Index>()), 0..16);
    (start, swaps, any::<u64>()).prop_map(|(start, swaps, seed)| {
        let mut assignment = std::array::from_fn(|i| samples::block(i as u8));
        for (a, other) in swaps {
            let same: Vec<_> = Inventory::standard().same_type(samples::block(a)).collect();
            assignment.swap(usize::from(a), same[other.index(same.len())].get());
        }
        Task { blueprint: "3_001".parse().unwrap(), assignment, start, seed }
    })
}

prop_compose! {
    fn trajectory()(two_grippers in any::<bool>())(
        actor in "[a-z0-9-]{1,64}",
        [epoch, seq, version] in any::<[u64; 3]>(),
        task in task(),
        first_step in 0..60_000u16,
        transitions in prop::collection::vec(transition(two_grippers), 1..4),
        last_scene in scene(two_grippers),
        status in prop::sample::select(vec![Status::Running, Status::Success, Status::TimeLimit]),
        lucky in any::<bool>(),
        behavior_policy in prop::sample::select(vec![BehaviorPolicy::Sampled, BehaviorPolicy::Greedy, BehaviorPolicy::Expert]),
        episode_return in reward(),
    ) -> Trajectory {
        let n_steps = first_step + transitions.len() as u16;
        let success = status == Status::Success || lucky;
        Trajectory {
            actor: actor.parse().unwrap(), epoch, seq, weights_version: WeightsVersion(version), settings_hash: seq, task,
            behavior_policy, first_step, transitions, last_scene, status,
            episode_stats: (status != Status::Running).then_some(EpisodeStats { success, n_steps, episode_return }),
        }
    }
}

/// Runs all decoders; they must return without panicking.
fn decode_all(bytes: &[u8]) {
    let _ = decode_trajectory(bytes);
    let _ = decode_recording(bytes);
    let _ = decode_weights(Bytes::copy_from_slice(bytes));
    let _ = decode_notice(bytes);
    let _ = decode_ack(bytes);
    let _ = decode_refused(bytes);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn trajectory_round_trips(trajectory in trajectory()) {
        prop_assert_eq!(decode_trajectory(&encode_trajectory(&trajectory)).unwrap(), trajectory);
    }

    #[test]
    fn weights_round_trip(
        parameters in prop::collection::vec(-1e6..1e6f32, 1..200),
        [epoch, version, n_env_steps, network_hash] in any::<[u64; 4]>(),
        [mean, std] in array::<2>(0.001..100.0),
    ) {
        let mut weights = Weights {
            version: WeightsVersion(version), n_env_steps, network_hash, parameters, ..samples::weights(0)
        };
        weights.normalization.value_mean = mean;
        weights.normalization.feature_std[2] = vec![std];
        weights.normalization.feature_mean[2] = vec![-mean];
        let decoded = decode_weights(encode_weights(&weights, epoch).into()).unwrap();
        prop_assert_eq!(decoded, PublishedWeights { epoch, weights });
    }

    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        decode_all(&bytes);
    }

    /// Far more changed messages than arbitrary bytes reach the validation rules.
    #[test]
    fn changed_messages_never_panic(
        which in 0..3usize,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        keep in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let mut bytes = match which {
            0 => encode_trajectory(&samples::successful("a", 1)),
            1 => encode_weights(&samples::weights(3), 1),
            _ => encode_refused(&Refused { refusal: Refusal::Invalid("x".into()), weights_version: WeightsVersion(1) }),
        };
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Some(keep) = keep {
            bytes.truncate(keep.index(bytes.len()));
        }
        decode_all(&bytes);
        // Accepted bytes decode to a valid value, which can be encoded again.
        if let Ok(trajectory) = decode_trajectory(&bytes) {
            prop_assert_eq!(decode_trajectory(&encode_trajectory(&trajectory)).unwrap(), trajectory);
        }
    }
}

//! The golden bytes of version 2. A change here breaks communication between old and new processes.

use super::samples;
use crate::codec::*;
use crate::{Disturbance, Start, WeightsVersion};

const GOLDEN: &str = include_str!("../../../tests/golden/v2.txt");

/// Returns the golden line of one message, and checks that its bytes decode to the same value.
#[track_caller]
fn line<T: PartialEq + std::fmt::Debug>(
    name: &str,
    value: T,
    encode: impl Fn(&T) -> Vec<u8>,
    decode: impl Fn(&[u8]) -> Result<T, DecodeError>,
) -> String {
    let bytes = encode(&value);
    assert_eq!(decode(&bytes).unwrap(), value);
    let hex: String = bytes.iter().map(|b| format!("{b:02x}")).collect();
    format!("{name} {hex}\n")
}

#[test]
fn encoded_bytes_match_the_golden_file() {
    let mut near_goal = samples::one_gripper("actor-1", 3);
    near_goal.task.start = Start::NearGoal { undone: 2 };
    near_goal.transitions.truncate(1);
    let mut disturbed = samples::of_expert("actor-1", 9);
    disturbed.transitions.truncate(1);
    disturbed.transitions[0].disturbance = Disturbance::new(samples::block(5), [0.5, 0.0, 0.25], [0.0, -1.5, 2.0]).ok();
    let version = WeightsVersion(300);
    let refused = |name, refusal| line(name, refusal, |refusal| encode_refusal(refusal, version), decode_refusal);
    let published = PublishedWeights { epoch: 77, weights: samples::weights(5) };
    let notice = WeightsNotice { epoch: 77, version };
    let lines = [
        line("trajectory-running", samples::running("actor-1", 7), encode_trajectory, decode_trajectory),
        line("trajectory-success", samples::successful("actor-1", 8), encode_trajectory, decode_trajectory),
        line("trajectory-one-gripper", near_goal, encode_trajectory, decode_trajectory),
        line("recording", samples::one_gripper("actor-1", 10), encode_recording, decode_recording),
        line("trajectory-disturbed", disturbed, encode_recording, decode_recording),
        line(
            "weights",
            published,
            |p| encode_weights(&p.weights, p.epoch),
            |bytes| decode_weights(Bytes::copy_from_slice(bytes)),
        ),
        line("notice", notice, |&n| encode_notice(n), decode_notice),
        line("ack", version, |&version| encode_ack(version), decode_ack),
        refused("refusal-stale", Refusal::Stale),
        refused("refusal-full", Refusal::Full),
        refused("refusal-invalid", Refusal::Invalid("seq is 1".into())),
        refused("refusal-name-taken", Refusal::NameTaken),
    ];
    let now = lines.concat();
    assert!(now == GOLDEN, "the bytes differ from tests/golden/v2.txt, they are now\n{now}");
}

//! Arbitrary bytes as each message of the bus: decoding never panics, and every accepted message survives a round trip.
#![no_main]

use std::fmt::Debug;

use libfuzzer_sys::fuzz_target;
use proto::DecodeError;
use proto::codec::*;

fuzz_target!(|bytes: &[u8]| {
    round_trip(bytes, decode_trajectory, encode_trajectory);
    round_trip(bytes, decode_recording, encode_recording);
    let _ = trajectory_actor(bytes);
    if let Ok(trajectory) = decode_trajectory(bytes) {
        let again = encode_trajectory(&trajectory);
        assert_eq!(trajectory_actor(&again).expect("the codec reads what it wrote"), trajectory.actor.as_str());
    }
    round_trip(
        bytes,
        |bytes| decode_weights(Bytes::copy_from_slice(bytes)),
        |published| encode_weights(&published.weights, published.epoch),
    );
    round_trip(bytes, decode_notice, |notice| encode_notice(*notice));
    round_trip(bytes, decode_ack, |version| encode_ack(*version));
    // The encoder truncates long explanations, so only its own output round-trips unchanged.
    if let Ok(refusal) = decode_refusal(bytes) {
        let encode = |refusal: &Refusal| encode_refusal(refusal, Default::default());
        round_trip(&encode(&refusal), decode_refusal, encode);
    }
});

/// Checks that a decoded value stays the same after encoding and decoding it again.
fn round_trip<T: PartialEq + Debug>(
    bytes: &[u8],
    decode: impl Fn(&[u8]) -> Result<T, DecodeError>,
    encode: impl Fn(&T) -> Vec<u8>,
) {
    let Ok(value) = decode(bytes) else { return };
    let again = decode(&encode(&value)).expect("the codec reads what it wrote");
    assert_eq!(again, value);
}

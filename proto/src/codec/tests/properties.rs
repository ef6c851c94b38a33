//! Bytes return a value that round-trips, or an error, never a panic.

use proptest::prelude::*;

use super::samples;
use crate::codec::*;
use crate::*;

/// Runs all decoders; they must return without panicking.
fn decode_all(bytes: &[u8]) {
    let _ = decode_trajectory(bytes);
    let _ = decode_recording(bytes);
    let _ = decode_weights(Bytes::copy_from_slice(bytes));
    let _ = decode_notice(bytes);
    let _ = decode_ack(bytes);
    let _ = decode_refusal(bytes);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn weights_round_trip(
        parameters in prop::collection::vec(-1e6..1e6f32, 1..200),
        [epoch, version, n_env_steps, network_hash] in any::<[u64; 4]>(),
        [mean, std] in prop::array::uniform2(0.001..100.0f32),
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
            _ => encode_refusal(&Refusal::Invalid("x".into()), WeightsVersion(1)),
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

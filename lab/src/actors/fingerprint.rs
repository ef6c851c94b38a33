//! Tells whether two processes counted the same trajectories.

use blueprints::hash::fnv1a;
use proto::Trajectory;

/// Returns a hash of the sender and the sequence number. If two processes counted the same trajectories, their wrapping
/// sums of fingerprints are equal.
pub(super) fn fingerprint(trajectory: &Trajectory) -> u64 {
    let text = trajectory.actor.as_str().bytes();
    let bytes = text.chain(trajectory.epoch.to_le_bytes()).chain(trajectory.seq.to_le_bytes());
    // A final mix, because sums of the plain hash are too regular.
    let hash = fnv1a(bytes);
    (hash ^ (hash >> 32)).wrapping_mul(0x9e37_79b9_7f4a_7c15)
}

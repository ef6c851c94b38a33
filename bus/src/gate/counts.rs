//! What became of the connections to a router.

use std::fmt;

use serde::{Deserialize, Serialize};

/// What became of the connections to a router with keys, since it started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct JoinCounts {
    /// Connections that are not yet members of the bus.
    pub n_pending: u64,
    /// Connections that became members.
    pub n_joined: u64,
    /// Connections that were turned away, for example without keys of this router, or that made room for newer ones.
    pub n_refused: u64,
    /// Connections that were dropped because they stood still.
    pub n_stalled: u64,
}

impl fmt::Display for JoinCounts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { n_pending, n_joined, n_refused, n_stalled } = self;
        write!(f, "joins: {n_joined} done, {n_pending} pending, {n_refused} refused, {n_stalled} stood still")
    }
}

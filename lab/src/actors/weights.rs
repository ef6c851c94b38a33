//! Measures how long weights take to reach the actors.

use std::time::{SystemTime, UNIX_EPOCH};

use proto::WeightsVersion;
use serde::{Deserialize, Serialize};

/// When a version of the weights was published, or reached an actor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Moment {
    pub(super) version: u64,
    /// Microseconds since 1970.
    pub(super) unix_us: u64,
}

impl Moment {
    /// This moment.
    pub(super) fn now(version: WeightsVersion) -> Self {
        let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self { version: version.0, unix_us: u64::try_from(since_1970.as_micros()).unwrap_or(u64::MAX) }
    }
}

/// How one version of the weights reached the actors.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Delivery {
    pub(super) version: u64,
    /// Actors that received this version, or a newer one, before the end.
    pub(super) n_reached: usize,
    pub(super) n_missing: usize,
    /// Time from the publication until half of the reached actors had it.
    pub(super) p50_s: f64,
    pub(super) p99_s: f64,
    pub(super) max_s: f64,
}

/// The delivery of every version that was published after the actors had started.
pub(super) fn deliveries(published: &[Moment], pulls: &[Vec<Moment>]) -> Vec<Delivery> {
    published.iter().filter_map(|publication| delivery(publication, pulls)).collect()
}

/// Returns `None` for weights that an actor started with.
fn delivery(publication: &Moment, pulls: &[Vec<Moment>]) -> Option<Delivery> {
    if pulls.iter().any(|pulls| pulls.first().is_some_and(|first| first.version >= publication.version)) {
        return None;
    }
    let arrival = |pulls: &Vec<Moment>| pulls.iter().find(|pull| pull.version >= publication.version).copied();
    let mut times: Vec<u64> = pulls.iter().filter_map(arrival).map(|pull| pull.unix_us).collect();
    times.sort_unstable();
    let after_s = |share: f64| {
        let rank = (share * times.len() as f64).ceil().max(1.0) as usize - 1;
        times.get(rank).map_or(0.0, |time| time.saturating_sub(publication.unix_us) as f64 / 1e6)
    };
    Some(Delivery {
        version: publication.version,
        n_reached: times.len(),
        n_missing: pulls.len() - times.len(),
        p50_s: after_s(0.5),
        p99_s: after_s(0.99),
        max_s: after_s(1.0),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_newer_version_counts_and_a_missing_one_is_counted() {
        let pull = |version, s: u64| Moment { version, unix_us: s * 1_000_000 };
        let pulls = vec![
            vec![pull(0, 1), pull(1, 11), pull(2, 21)],
            // This actor skipped version 1.
            vec![pull(0, 1), pull(2, 24)],
            vec![pull(0, 1), pull(1, 13)],
        ];
        let published = [0, 1, 2].map(|version| Moment { version, unix_us: version * 10_000_000 });
        let found = deliveries(&published, &pulls);
        let expected = [(1, 3, 0, 3.0, 14.0), (2, 2, 1, 1.0, 4.0)];
        let rows = found.iter().map(|d| (d.version, d.n_reached, d.n_missing, d.p50_s, d.max_s));
        assert_eq!(rows.collect::<Vec<_>>(), expected);
    }
}

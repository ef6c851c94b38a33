//! Durations in buckets that are 3 % wide, so that those of many processes can be merged.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::{Deserialize, Serialize};

/// Number of buckets between consecutive powers of two.
const N_PARTS: u64 = 32;

/// A histogram of durations.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Histogram {
    /// Number of durations in each bucket; see [`upper_us`].
    buckets: BTreeMap<u16, u64>,
    /// Number of durations.
    pub(super) n: u64,
    max_us: u64,
}

impl Histogram {
    /// Counts a duration.
    pub(crate) fn add(&mut self, time: Duration) {
        let us = u64::try_from(time.as_micros()).unwrap_or(u64::MAX);
        *self.buckets.entry(bucket(us)).or_default() += 1;
        self.n += 1;
        self.max_us = self.max_us.max(us);
    }

    /// Adds the counts of `other`.
    pub(crate) fn merge(&mut self, other: &Self) {
        for (&bucket, n) in &other.buckets {
            *self.buckets.entry(bucket).or_default() += n;
        }
        self.n += other.n;
        self.max_us = self.max_us.max(other.max_us);
    }

    /// Returns the quantile at `share`, 0 to 1, at most 3 % too long; `None` if nothing was counted.
    pub(crate) fn quantile(&self, share: f64) -> Option<Duration> {
        let rank = ((share * self.n as f64).ceil() as u64).clamp(1, self.n.max(1));
        let mut n_below = 0;
        let bucket = self.buckets.iter().find_map(|(&bucket, n)| {
            n_below += n;
            (n_below >= rank).then_some(bucket)
        })?;
        Some(Duration::from_micros(upper_us(bucket).min(self.max_us)))
    }

    /// Returns the longest duration; zero if nothing was counted.
    pub(crate) fn max(&self) -> Duration {
        Duration::from_micros(self.max_us)
    }
}

/// Returns the bucket of a duration: one each below 32 µs, and 32 between consecutive powers of two above.
fn bucket(us: u64) -> u16 {
    if us < N_PARTS {
        return us as u16;
    }
    let shift = us.ilog2() - N_PARTS.ilog2();
    (u64::from(shift) * N_PARTS + (us >> shift)) as u16
}

/// Returns the longest duration of a bucket.
fn upper_us(bucket: u16) -> u64 {
    let bucket = u64::from(bucket);
    if bucket < 2 * N_PARTS {
        return bucket;
    }
    let shift = bucket / N_PARTS - 1;
    (((bucket % N_PARTS + N_PARTS + 1) as u128) << shift).saturating_sub(1).min(u128::from(u64::MAX)) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bucket_holds_times_up_to_its_bound() {
        for us in (0..5000).chain([1 << 20, (1 << 40) + 12_345, u64::MAX]) {
            let upper = upper_us(bucket(us));
            assert!(us <= upper && upper as f64 <= us as f64 * (1.0 + 1.0 / 32.0), "{us} in a bucket up to {upper}");
            assert!(upper == u64::MAX || bucket(upper + 1) == bucket(us) + 1, "{us}");
        }
    }

    #[test]
    fn quantiles_of_two_histograms_together() {
        let (mut low, mut high) = (Histogram::default(), Histogram::default());
        (1..=30).for_each(|us| low.add(Duration::from_micros(us)));
        (1..=10).for_each(|ms| high.add(Duration::from_millis(ms)));
        low.merge(&high);
        assert_eq!(
            (low.n, low.quantile(0.5), low.max()),
            (40, Some(Duration::from_micros(20)), Duration::from_millis(10))
        );
        assert_eq!(low.quantile(1.0), Some(Duration::from_millis(10)));
        assert_eq!(Histogram::default().quantile(0.5), None);
    }
}

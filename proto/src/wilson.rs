//! Confidence intervals of success rates.

use serde::{Deserialize, Serialize};

/// The two-sided 95 % quantile of the standard normal distribution.
const Z_95: f64 = 1.959_963_984_540_054;

/// A success rate with its 95 % Wilson score interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SuccessRate {
    /// Episodes that succeeded.
    pub n_successes: u64,
    /// All episodes.
    pub n_episodes: u64,
    /// `n_successes / n_episodes`, 0 without episodes.
    pub rate: f64,
    /// Lower end of the interval, 0 without episodes.
    pub wilson_low: f64,
    /// Upper end of the interval, 1 without episodes.
    pub wilson_high: f64,
}

impl Default for SuccessRate {
    /// Returns the rate without episodes.
    fn default() -> Self {
        Self::new(0, 0)
    }
}

impl SuccessRate {
    /// Computes the rate and interval of these counts (E. B. Wilson, 1927, doi:10.1080/01621459.1927.10502953).
    ///
    /// Unlike the normal approximation, the interval is valid for zero successes and for all successes, where
    /// evaluations begin and end.
    ///
    /// # Panics
    /// If there are more successes than episodes.
    pub fn new(n_successes: u64, n_episodes: u64) -> Self {
        assert!(n_successes <= n_episodes, "{n_successes} successes in {n_episodes} episodes");
        let n = n_episodes as f64;
        let rate = if n_episodes == 0 { 0.0 } else { n_successes as f64 / n };
        let z2 = Z_95 * Z_95;
        let center = (rate + z2 / (2.0 * n)) / (1.0 + z2 / n);
        let half_width = Z_95 / (1.0 + z2 / n) * (rate * (1.0 - rate) / n + z2 / (4.0 * n * n)).sqrt();
        // Set the ends to exactly 0 and 1, which rounding would miss. Without episodes, both are set.
        let wilson_low = if n_successes == 0 { 0.0 } else { center - half_width };
        let wilson_high = if n_successes == n_episodes { 1.0 } else { center + half_width };
        Self { n_successes, n_episodes, rate, wilson_low, wilson_high }
    }
}

impl std::iter::Sum for SuccessRate {
    /// Returns the rate of all episodes together.
    fn sum<I: Iterator<Item = Self>>(rates: I) -> Self {
        let (n_successes, n_episodes) =
            rates.fold((0, 0), |(hits, all), rate| (hits + rate.n_successes, all + rate.n_episodes));
        Self::new(n_successes, n_episodes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(n_successes: u64, n_episodes: u64, low: f64, high: f64) {
        let found = SuccessRate::new(n_successes, n_episodes);
        assert!((found.wilson_low - low).abs() < 5e-5 && (found.wilson_high - high).abs() < 5e-5, "{found:?}");
    }

    #[test]
    fn wilson_interval_matches_hand_worked_values() {
        // z² = 3.841459. With n = 40 and p = 1: high is 1 and low = n / (n + z²) = 40 / 43.841459.
        check(40, 40, 0.9124, 1.0);
        // p = 0 mirrors it: z² / (n + z²) = 3.841459 / 43.841459.
        check(0, 40, 0.0, 0.0876);
        // n = 10, p = 1/2: center 1/2, half width z/2 / √(n + z²) = 0.979982 / √13.841459 = 0.263406.
        check(5, 10, 0.2366, 0.7634);
        // One episode: z² / (1 + z²) = 3.841459 / 4.841459.
        check(0, 1, 0.0, 0.7935);
        check(0, 0, 0.0, 1.0);
    }

    #[test]
    fn success_rate_lies_in_its_interval() {
        for n_episodes in 1..50 {
            for n_successes in 0..=n_episodes {
                let s = SuccessRate::new(n_successes, n_episodes);
                assert!(0.0 <= s.wilson_low && s.wilson_low <= s.rate, "{s:?}");
                assert!(s.rate <= s.wilson_high && s.wilson_high <= 1.0, "{s:?}");
            }
        }
    }
}

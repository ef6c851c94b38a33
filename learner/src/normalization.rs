//! Running statistics of the value targets. [`policy::normalization`] has the feature statistics.
//!
//! Feature statistics change only *after* an update, so a batch is trained on with the statistics that were in effect
//! when its newest steps were taken. They freeze after half a million scenes. Value statistics change *before*
//! the gradient steps, and the value head is rescaled to keep its output in reward units unchanged (PopArt: van Hasselt
//! et al., "Learning values across many orders of magnitude", proposition 1).

use proto::InvalidSetting;
use proto::setting::{Setting, above};
use serde::{Deserialize, Serialize};

/// Weight of a new batch in the running statistics of the value targets.
const VALUE_RATE: f64 = 0.1;
/// Minimum standard deviation of the value targets, reward units.
const MIN_VALUE_STD: f32 = 0.01;

/// Running mean and standard deviation of the value targets, in reward units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ValueStatistics {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub std: f64,
    mean_square: f64,
    n_batches: u64,
}

impl Default for ValueStatistics {
    fn default() -> Self {
        Self { mean: 0.0, std: 1.0, mean_square: 1.0, n_batches: 0 }
    }
}

impl ValueStatistics {
    /// Creates statistics from known values; they then change as if many batches had been seen.
    pub fn new(mean: f32, std: f32) -> Self {
        let (mean, std) = (f64::from(mean), f64::from(std));
        Self { mean, std, mean_square: std * std + mean * mean, n_batches: 1_000 }
    }

    /// Checks the numbers of a saved run; `path` is the key of these statistics.
    pub(crate) fn check(&self, path: &str) -> Result<(), InvalidSetting> {
        self.mean.check_in(&format!("{path}.mean"), &(..))?;
        self.std.check_in(&format!("{path}.std"), &above(0.0))?;
        self.mean_square.check_in(&format!("{path}.mean_square"), &(0.0..))
    }

    /// Returns the statistics after a batch of targets, which has weight 0.1, or more while few batches have been seen.
    pub fn after(&self, targets: &[f32]) -> Self {
        if targets.is_empty() {
            return *self;
        }
        let n = targets.len() as f64;
        let batch_mean = targets.iter().map(|&x| f64::from(x)).sum::<f64>() / n;
        let batch_square = targets.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>() / n;
        let rate = VALUE_RATE.max(1.0 / (self.n_batches + 1) as f64);
        let mean = self.mean + rate * (batch_mean - self.mean);
        let mean_square = self.mean_square + rate * (batch_square - self.mean_square);
        let std = (mean_square - mean * mean).max(0.0).sqrt().max(f64::from(MIN_VALUE_STD));
        Self { mean, std, mean_square, n_batches: self.n_batches + 1 }
    }

    /// Rescales the last layer of the value head so that `std · output + mean` is the same under `next` as before.
    pub fn rescale_head(&self, next: &Self, weights: &mut [f32], bias: &mut f32) {
        let scale = self.std / next.std;
        for w in weights {
            *w = (f64::from(*w) * scale) as f32;
        }
        *bias = ((self.std * f64::from(*bias) + self.mean - next.mean) / next.std) as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rescaled_head_keeps_its_output_in_reward_units() {
        let before = ValueStatistics::default();
        // The first batch has full weight: mean 3, standard deviation 1.
        let after = before.after(&[2.0, 4.0]);
        assert!((after.mean - 3.0).abs() < 1e-12 && (after.std - 1.0).abs() < 1e-12);
        // The second has half of it.
        let later = after.after(&[20.0, 40.0]);
        let mut weights = [0.5, -2.0];
        let mut bias = 0.25;
        let value = |s: &ValueStatistics, w: &[f32; 2], b: f32| s.std * f64::from(w[0] * 3.0 + w[1] * 7.0 + b) + s.mean;
        let old = value(&after, &weights, bias);
        after.rescale_head(&later, &mut weights, &mut bias);
        assert!((value(&later, &weights, bias) - old).abs() < 1e-4);
        assert!(later.std > 10.0);
    }

    #[test]
    fn constant_targets_have_the_minimum_deviation() {
        let statistics = ValueStatistics::default().after(&[5.0; 4]);
        assert_eq!((statistics.mean, statistics.std), (5.0, f64::from(0.01_f32)));
    }
}

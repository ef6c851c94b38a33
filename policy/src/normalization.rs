//! Running statistics of features, and normalization, shared by actors, evaluator, and learner.

use proto::setting::{Setting, above};
use proto::{InvalidSetting, Normalization};
use serde::{Deserialize, Serialize};

use crate::FeatureBatch;

/// Minimum standard deviation used as a divisor.
///
/// Most edge features are zero (pairs outside the blueprint), so their standard deviations are small because of
/// sparsity, not because of the unit. Without this minimum, the few entries that matter would become huge.
pub const MIN_FEATURE_STD: f32 = 0.1;

/// Normalized features are clipped to ± this value.
pub const MAX_NORMALIZED: f32 = 10.0;

/// Count, mean, and sum of squared deviations of each feature (Welford), in `f64`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FeatureMoments {
    groups: [Moments; 3],
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Moments {
    count: f64,
    mean: Vec<f64>,
    squares: Vec<f64>,
    /// Features whose values so far are only 0 and 1: bits and one-hots, which are not normalized.
    is_bit: Vec<bool>,
}

impl FeatureMoments {
    /// Adds a batch of unnormalized features.
    pub fn push(&mut self, batch: &FeatureBatch) {
        let values =
            [(&batch.nodes, batch.sizes.node), (&batch.edges, batch.sizes.edge), (&batch.globals, batch.sizes.global)];
        for (group, (values, width)) in self.groups.iter_mut().zip(values) {
            values.chunks_exact(width).for_each(|row| group.push(row));
        }
    }

    /// Checks the numbers of saved moments of `widths` features; `path` is their key.
    ///
    /// # Errors
    /// Returns the first number that no features have, or the first list of another length.
    pub fn check(&self, path: &str, widths: [usize; 3]) -> Result<(), InvalidSetting> {
        for (k, (group, width)) in self.groups.iter().zip(widths).enumerate() {
            let path = format!("{path}.groups[{k}]");
            let Moments { count, mean, squares, is_bit } = group;
            let n = mean.len();
            let fits = (n == width || n == 0) && squares.len() == n && is_bit.len() == n;
            InvalidSetting::check(&path, format_args!("{n} means"), fits, format_args!("{width} of each or none"))?;
            count.check_in(&format!("{path}.count"), &(0.0..))?;
            mean.check_in(&format!("{path}.mean"), &(..))?;
            squares.check_in(&format!("{path}.squares"), &(0.0..))?;
        }
        Ok(())
    }

    /// Writes the current mean and standard deviation into `to`; its value statistics stay unchanged.
    pub fn freeze_into(&self, to: &mut Normalization) {
        for (k, group) in self.groups.iter().enumerate() {
            (to.feature_mean[k], to.feature_std[k]) = group.freeze();
        }
    }
}

impl Moments {
    fn push(&mut self, row: &[f32]) {
        if self.mean.is_empty() {
            self.mean = vec![0.0; row.len()];
            self.squares = vec![0.0; row.len()];
            self.is_bit = vec![true; row.len()];
        }
        self.count += 1.0;
        for (k, x) in row.iter().enumerate() {
            let x = f64::from(*x);
            let delta = x - self.mean[k];
            self.mean[k] += delta / self.count;
            self.squares[k] += delta * (x - self.mean[k]);
            self.is_bit[k] &= x == 0.0 || x == 1.0;
        }
    }

    fn freeze(&self) -> (Vec<f32>, Vec<f32>) {
        let std = |k: usize| ((self.squares[k] / self.count.max(1.0)).sqrt() as f32).max(MIN_FEATURE_STD);
        let features = 0..self.mean.len();
        features.map(|k| if self.is_bit[k] { (0.0, 1.0) } else { (self.mean[k] as f32, std(k)) }).unzip()
    }
}

/// Checks the statistics of `widths` features; `path` is their key.
///
/// # Errors
/// Returns the first number that cannot normalize anything, or the first list of another length.
pub fn check(path: &str, normalization: &Normalization, widths: [usize; 3]) -> Result<(), InvalidSetting> {
    let Normalization { feature_mean, feature_std, value_mean, value_std } = normalization;
    for (k, width) in widths.into_iter().enumerate() {
        for (key, n) in [("feature_mean", feature_mean[k].len()), ("feature_std", feature_std[k].len())] {
            let fits = n == width || (n == 0 && feature_mean[k].len() == feature_std[k].len());
            InvalidSetting::check(format_args!("{path}.{key}[{k}]"), format_args!("{n} numbers"), fits, width)?;
        }
        feature_mean[k].check_in(&format!("{path}.feature_mean[{k}]"), &(..))?;
        feature_std[k].check_in(&format!("{path}.feature_std[{k}]"), &above(0.0))?;
    }
    value_mean.check_in(&format!("{path}.value_mean"), &(..))?;
    value_std.check_in(&format!("{path}.value_std"), &above(0.0))
}

/// Replaces each feature by `(x − mean) / std`, clipped to ±[`MAX_NORMALIZED`], in each group that has statistics. The
/// other groups stay unchanged.
///
/// # Panics
/// If the number of statistics differs from the number of features; [`crate::Policy::load`] checks this.
pub fn normalize(batch: &mut FeatureBatch, normalization: &Normalization) {
    let groups = [&mut batch.nodes, &mut batch.edges, &mut batch.globals];
    for (k, values) in groups.into_iter().enumerate() {
        let (mean, std) = (&normalization.feature_mean[k], &normalization.feature_std[k]);
        if mean.is_empty() {
            continue;
        }
        for row in values.chunks_exact_mut(mean.len()) {
            for ((x, mean), std) in row.iter_mut().zip(mean).zip(std) {
                *x = ((*x - mean) / std).clamp(-MAX_NORMALIZED, MAX_NORMALIZED);
            }
        }
    }
}

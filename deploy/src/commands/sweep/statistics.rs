//! Success over several seeds: mean, interquartile mean, and stratified bootstrap intervals, as recommended by Agarwal
//! et al. (2021, arXiv:2108.13264).

use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};
use serde::Serialize;

/// Number of bootstrap samples.
const N_SAMPLES: usize = 2000;

/// Aggregates of the success rates of several runs on several goals.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Aggregate {
    /// Mean over runs and goals.
    pub(super) mean: f64,
    /// 95 % interval of the mean; `null` with one run.
    pub(super) mean_interval: Option<[f64; 2]>,
    /// Mean of the middle half of all runs and goals.
    pub(super) iqm: f64,
    /// 95 % interval of the interquartile mean; `null` with one run.
    pub(super) iqm_interval: Option<[f64; 2]>,
}

impl Aggregate {
    /// Aggregates `scores`, which has the rates of all runs for each goal.
    ///
    /// A bootstrap sample draws as many runs as there are, with replacement and for each goal on its own: goals are the
    /// strata, as none of them was drawn. The same scores give the same intervals.
    pub(super) fn of(scores: &[Vec<f64>]) -> Self {
        let all = scores.concat();
        let (mean_of_all, iqm_of_all) = (mean(&all), iqm(&all));
        if scores.iter().all(|runs| runs.len() < 2) {
            return Self { mean: mean_of_all, mean_interval: None, iqm: iqm_of_all, iqm_interval: None };
        }
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let sample = |_| {
            let draw = |runs: &Vec<f64>| (0..runs.len()).map(|_| runs[rng.random_range(0..runs.len())]).collect();
            let drawn: Vec<Vec<f64>> = scores.iter().map(draw).collect();
            let drawn = drawn.concat();
            (mean(&drawn), iqm(&drawn))
        };
        let (means, iqms): (Vec<f64>, Vec<f64>) = (0..N_SAMPLES).map(sample).unzip();
        let mean_interval = Some(interval(means));
        Self { mean: mean_of_all, mean_interval, iqm: iqm_of_all, iqm_interval: Some(interval(iqms)) }
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// The mean of what is left without the lowest and the highest quarter, each rounded down to whole values.
fn iqm(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let n_cut = sorted.len() / 4;
    mean(&sorted[n_cut..sorted.len() - n_cut])
}

/// The 2.5 % and 97.5 % quantiles.
fn interval(mut values: Vec<f64>) -> [f64; 2] {
    values.sort_by(f64::total_cmp);
    [0.025, 0.975].map(|share| quantile(&values, share))
}

/// A quantile of sorted values, interpolated between the two nearest ones.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let position = share * sorted.len().saturating_sub(1) as f64;
    let low = position.floor() as usize;
    let rest = position.fract();
    let at = |i: usize| sorted.get(i).or(sorted.last()).copied().unwrap_or(f64::NAN);
    at(low) + rest * (at(low + 1) - at(low))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interquartile_mean_leaves_out_a_quarter_at_each_end() {
        // Of eight values, two at each end: (0.3 + 0.4 + 0.5 + 0.8) / 4.
        let eight = [1.0, 0.3, 0.0, 0.5, 0.1, 0.9, 0.4, 0.8];
        assert!((iqm(&eight) - 0.5).abs() < 1e-12);
        // Of six, one at each end (1.5, rounded down): (0.1 + 0.2 + 0.3 + 0.4) / 4.
        assert!((iqm(&[0.0, 0.1, 0.2, 0.3, 0.4, 1.0]) - 0.25).abs() < 1e-12);
        // Of three, none.
        assert!((iqm(&[0.0, 0.3, 0.9]) - 0.4).abs() < 1e-12);
        assert_eq!(mean(&eight), 0.5);
    }

    #[test]
    fn quantiles_are_interpolated() {
        let sorted = [0.0, 1.0, 2.0, 3.0, 4.0];
        // 0.025 · 4 = 0.1 and 0.975 · 4 = 3.9.
        assert_eq!(interval(sorted.to_vec()), [0.1, 3.9]);
        assert_eq!(quantile(&sorted, 0.5), 2.0);
    }

    #[test]
    fn goals_are_strata_of_the_bootstrap() {
        // Runs agree on each goal, so no sample differs from the scores; a bootstrap over all of them would.
        let same = Aggregate::of(&[vec![0.0; 3], vec![1.0; 3]]);
        assert_eq!((same.mean, same.mean_interval, same.iqm_interval), (0.5, Some([0.5, 0.5]), Some([0.5, 0.5])));
        // Two runs with 0 and 1 give 0, 1/2 or 1, the extremes with a quarter of the probability each.
        let two = Aggregate::of(&[vec![0.0, 1.0]]);
        assert_eq!((two.mean, two.mean_interval), (0.5, Some([0.0, 1.0])));
        assert_eq!(Aggregate::of(&[vec![0.0, 1.0]]), two, "the same scores give the same interval");
        let one = Aggregate::of(&[vec![0.25], vec![0.75]]);
        assert_eq!((one.mean, one.iqm, one.iqm_interval), (0.5, 0.5, None));
    }
}

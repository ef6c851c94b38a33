//! The PPO objective, on tensors for gradients and on slices for plain numbers.

use burn::tensor::Tensor;

/// Maximum importance weight of a sample with the decoupled objective.
const MAX_BEHAVIOR_WEIGHT: f32 = 2.0;

/// Returns the negative clipped surrogate of each sample, `−w · min(r A, clip(r, 1 ± ε) A)` with
/// `r = exp(log_prob − reference)` (Schulman et al., "Proximal policy optimization algorithms", eq. 7). The weights `w`
/// are the importance weights of the decoupled objective; otherwise they are 1.
///
/// # Shapes
/// All `[B]`, including the result.
pub fn policy_loss(
    log_prob: Tensor<1>,
    reference: Tensor<1>,
    weight: Tensor<1>,
    advantage: Tensor<1>,
    clip: f32,
) -> Tensor<1> {
    let ratio = (log_prob - reference).exp();
    let clipped = ratio.clone().clamp(1.0 - clip, 1.0 + clip) * advantage.clone();
    -((ratio * advantage).min_pair(clipped) * weight)
}

/// Returns half the squared error of each value.
///
/// # Shapes
/// All `[B]`, including the result.
pub fn value_loss(value: Tensor<1>, target: Tensor<1>) -> Tensor<1> {
    (value - target).square() * 0.5
}

/// Statistics of a policy's distance from its reference; means over samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RatioStatistics {
    /// Estimate of KL(reference ‖ policy), `mean((r − 1) − ln r)`, nats; never negative (Schulman's k3).
    pub approx_kl: f64,
    /// Fraction of samples with |r − 1| > ε.
    pub clip_fraction: f64,
}

impl RatioStatistics {
    /// Computes the statistics from log-probabilities `new` and `reference`, one entry per sample.
    pub fn new(new: &[f32], reference: &[f32], clip: f32) -> Self {
        let n = new.len().max(1) as f64;
        let mut sums = Self::default();
        for (&new, &reference) in new.iter().zip(reference) {
            let log_ratio = f64::from(new) - f64::from(reference);
            // JSON has no infinity.
            let ratio = log_ratio.exp().min(1e300);
            sums.approx_kl += (ratio - 1.0) - log_ratio;
            sums.clip_fraction += f64::from(u8::from((ratio - 1.0).abs() > f64::from(clip)));
        }
        Self { approx_kl: sums.approx_kl / n, clip_fraction: sums.clip_fraction / n }
    }
}

/// Returns the importance ratios `π_now / π_acted` of the samples from their log-probabilities.
///
/// # Shapes
/// One entry per sample.
pub fn importance_ratios(now: &[f32], acted: &[f32]) -> Vec<f32> {
    now.iter().zip(acted).map(|(now, acted)| (now - acted).exp()).collect()
}

/// Returns the importance ratios, at most 2.
pub fn behavior_weights(ratios: &[f32]) -> Vec<f32> {
    ratios.iter().map(|ratio| ratio.min(MAX_BEHAVIOR_WEIGHT)).collect()
}

/// Returns `(Σw)² / (n Σw²)` of importance weights, the effective fraction of the samples; 1 if all weights are equal.
pub fn effective_sample_size(now: &[f32], acted: &[f32]) -> f64 {
    // Factor out the largest weight, so that nothing overflows.
    let log_weights: Vec<f64> = now.iter().zip(acted).map(|(n, a)| f64::from(*n) - f64::from(*a)).collect();
    let max = log_weights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let (sum, squares) = log_weights.iter().map(|l| (l - max).exp()).fold((0.0, 0.0), |(s, q), w| (s + w, q + w * w));
    if squares > 0.0 { sum * sum / (squares * log_weights.len() as f64) } else { 0.0 }
}

/// Returns `1 − Var(target − value) / Var(target)`: 1 for a perfect critic, 0 for a constant critic or constant
/// targets.
pub fn explained_variance(values: &[f32], targets: &[f32]) -> f64 {
    let variance = |xs: &mut dyn Iterator<Item = f64>| {
        let (n, sum, squares) = xs.fold((0.0, 0.0, 0.0), |(n, s, q), x| (n + 1.0, s + x, q + x * x));
        if n > 0.0 { squares / n - (sum / n) * (sum / n) } else { 0.0 }
    };
    let of_targets = variance(&mut targets.iter().map(|&x| f64::from(x)));
    let of_errors = variance(&mut targets.iter().zip(values).map(|(&t, &v)| f64::from(t) - f64::from(v)));
    if of_targets > 1e-12 { 1.0 - of_errors / of_targets } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn effective_sample_size_drops_with_lag() {
        assert!((effective_sample_size(&[-1.0, -2.0], &[-1.0, -2.0]) - 1.0).abs() < 1e-12);
        // Weights 1 and 3: 16 / (2 · 10) = 0.8.
        assert!((effective_sample_size(&[0.0, 3.0f32.ln()], &[0.0, 0.0]) - 0.8).abs() < 1e-6);
        assert_eq!(behavior_weights(&importance_ratios(&[0.0, 3.0f32.ln()], &[0.0, 0.0])), [1.0, 2.0]);
    }

    #[test]
    fn explained_variance_of_a_perfect_a_constant_and_a_wrong_critic() {
        let targets = [1.0, 3.0];
        assert!((explained_variance(&[1.0, 3.0], &targets) - 1.0).abs() < 1e-12);
        assert!(explained_variance(&[7.0, 7.0], &targets).abs() < 1e-12);
        // Errors −2 and 2 have variance 4; the targets have variance 1.
        assert!((explained_variance(&[3.0, 1.0], &targets) + 3.0).abs() < 1e-12);
        assert_eq!(explained_variance(&[1.0, 3.0], &[2.0, 2.0]), 0.0);
    }
}

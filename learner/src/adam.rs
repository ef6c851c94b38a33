//! Adam, global-norm clipping, and the learning-rate rule, on flat vectors.
//!
//! The optimizer works on the flat parameter vector that is sent to the actors. Its moments are two plain vectors, so a
//! checkpoint is exact and needs no tree of tensors. The optimizer takes less than 1 % of an update's time.

use serde::{Deserialize, Serialize};

use crate::config::AdaptiveRate;

/// Adam's ε, outside the square root.
pub const EPSILON: f32 = 1e-5;
/// Adam's β₁.
pub const BETA1: f64 = 0.9;
/// Adam's β₂.
pub const BETA2: f64 = 0.999;

/// Factor by which the adaptive rate grows or shrinks.
const RATE_FACTOR: f32 = 1.5;

/// Adam's state (Kingma & Ba, "Adam: a method for stochastic optimization", algorithm 1).
#[derive(Clone, Debug, PartialEq)]
pub struct Adam {
    /// First moment, one entry per parameter.
    pub first: Vec<f32>,
    /// Second moment, one entry per parameter.
    pub second: Vec<f32>,
    /// Steps taken.
    pub n_steps: u64,
}

/// The learning rate, adapted to the KL divergence of the updates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct LearningRate(pub f32);

impl Adam {
    /// Creates the initial state for `n` parameters.
    pub fn new(n: usize) -> Self {
        Self { first: vec![0.0; n], second: vec![0.0; n], n_steps: 0 }
    }

    /// Takes one step down `gradient`: `w −= lr · m̂ / (√v̂ + ε)` with bias-corrected moments.
    ///
    /// # Shapes
    /// `parameters` and `gradient` have one entry per parameter of this state.
    ///
    /// # Panics
    /// If the lengths differ.
    pub fn step(&mut self, parameters: &mut [f32], gradient: &[f32], rate: LearningRate) {
        assert!(parameters.len() == self.first.len() && gradient.len() == self.first.len(), "one entry per parameter");
        self.n_steps += 1;
        // Compute 1 − β in f64: in f32 its relative error is 1e-5 for β₂.
        let (b1, b2) = (BETA1 as f32, BETA2 as f32);
        let (c1, c2) = ((1.0 - BETA1) as f32, (1.0 - BETA2) as f32);
        let exponent = self.n_steps as f64;
        let correction1 = (1.0 - BETA1.powf(exponent)) as f32;
        let correction2 = (1.0 - BETA2.powf(exponent)).sqrt() as f32;
        let size = rate.0 / correction1;
        let moments = self.first.iter_mut().zip(&mut self.second);
        for ((w, &g), (m, v)) in parameters.iter_mut().zip(gradient).zip(moments) {
            *m = b1 * *m + c1 * g;
            *v = b2 * *v + c2 * g * g;
            *w -= size * *m / (v.sqrt() / correction2 + EPSILON);
        }
    }
}

impl LearningRate {
    /// Returns the rate for the next update, after one that moved the policy by `kl` nats.
    pub fn adapted(self, kl: f32, rule: &AdaptiveRate) -> Self {
        if kl > rule.high_kl {
            Self((self.0 / RATE_FACTOR).max(rule.min))
        } else if kl < rule.low_kl {
            Self((self.0 * RATE_FACTOR).min(rule.max))
        } else {
            self
        }
    }
}

/// Scales `gradient` by `min(1, max_norm / ‖gradient‖)` and returns the norm before clipping.
pub fn clip_global_norm(gradient: &mut [f32], max_norm: f32) -> f32 {
    // Partial sums in f32 are vectorized; their total in f64 is accurate enough for a million squares.
    let sum: f64 = gradient.chunks(1024).map(|chunk| f64::from(chunk.iter().map(|g| g * g).sum::<f32>())).sum();
    let norm = sum.sqrt() as f32;
    if norm > max_norm {
        let scale = max_norm / norm;
        for g in gradient {
            *g *= scale;
        }
    }
    norm
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_adam_step_moves_by_the_learning_rate() {
        // m̂ = g and v̂ = g², so the step is lr · sign(g) up to ε.
        let mut adam = Adam::new(2);
        let mut w = [1.0, 1.0];
        adam.step(&mut w, &[0.5, -2.0], LearningRate(0.1));
        assert!((w[0] - 0.9).abs() < 1e-5 && (w[1] - 1.1).abs() < 1e-5, "{w:?}");
    }

    #[test]
    fn norm_is_clipped_only_if_larger() {
        let mut gradient = [3.0, 4.0];
        assert_eq!(clip_global_norm(&mut gradient, 10.0), 5.0);
        assert_eq!(gradient, [3.0, 4.0]);
        assert_eq!(clip_global_norm(&mut gradient, 1.0), 5.0);
        assert!((gradient[0] - 0.6).abs() < 1e-7 && (gradient[1] - 0.8).abs() < 1e-7);
    }

    #[test]
    fn learning_rate_follows_the_kl_within_bounds() {
        let rule = AdaptiveRate::default();
        for (rate, kl, expected) in
            [(3e-4, 0.03, 2e-4), (3e-4, 0.001, 4.5e-4), (3e-4, 0.01, 3e-4), (1.2e-5, 1.0, 1e-5), (9e-4, 0.0, 1e-3)]
        {
            let next = LearningRate(rate).adapted(kl, &rule).0;
            assert!((next - expected).abs() < 1e-9, "{rate} at {kl} gives {next}");
        }
    }
}

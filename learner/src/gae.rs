//! Generalized advantage estimation over one segment of an episode.

use proto::Status;

use crate::advantages::{Estimator, Steps};

/// `A_t = δ_t + γλ A_{t+1}` with `δ_t = r_t + γ v_{t+1} − v_t` and `A = 0` past the end (Schulman et al.,
/// "High-dimensional continuous control using generalized advantage estimation", eq. 16).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gae {
    /// Discount per step, γ.
    pub gamma: f32,
    /// Weight of later errors, λ.
    pub lambda: f32,
}

impl Estimator for Gae {
    fn advantages(&self, steps: &Steps<'_>, advantages: &mut [f32]) {
        let Steps { rewards, values, bootstrap, .. } = *steps;
        let mut next_value = bootstrap;
        let mut next_advantage = 0.0;
        for t in (0..rewards.len()).rev() {
            let delta = rewards[t] + self.gamma * next_value - values[t];
            next_advantage = delta + self.gamma * self.lambda * next_advantage;
            advantages[t] = next_advantage;
            next_value = values[t];
        }
    }
}

/// Returns the value after a segment's last step: 0 after success, and otherwise the critic's value of the last scene.
/// Treating the time limit as an end would teach the critic that long episodes are worthless.
pub fn bootstrap_value(status: Status, last_value: f32) -> f32 {
    match status {
        Status::Success => 0.0,
        Status::Running | Status::TimeLimit | Status::Diverged => last_value,
    }
}

/// Normalizes to mean 0 and standard deviation 1: `(x − mean) / (population deviation + 1e-8)`.
pub fn normalize(values: &mut [f32]) {
    let n = values.len().max(1) as f64;
    let mean = values.iter().map(|&x| f64::from(x)).sum::<f64>() / n;
    let variance = values.iter().map(|&x| (f64::from(x) - mean).powi(2)).sum::<f64>() / n;
    let scale = 1.0 / (variance.sqrt() + 1e-8);
    for x in values {
        *x = ((f64::from(*x) - mean) * scale) as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn advantages_match_a_hand_worked_segment() {
        // γ = 0.5, λ = 0.5. δ₁ = 2 + 0.5·4 − 2 = 2; δ₀ = 1 + 0.5·2 − 1 = 1; A₁ = 2; A₀ = 1 + 0.25·2 = 1.5.
        let of = |bootstrap| {
            let steps = Steps { rewards: &[1.0, 2.0], values: &[1.0, 2.0], bootstrap, ratios: &[1.0; 2] };
            let mut out = [0.0; 2];
            Gae { gamma: 0.5, lambda: 0.5 }.advantages(&steps, &mut out);
            out
        };
        assert_eq!(of(4.0), [1.5, 2.0]);
        // Success: δ₁ = 2 − 2 = 0, so A₁ = 0 and A₀ = 1.
        assert_eq!(of(bootstrap_value(Status::Success, 4.0)), [1.0, 0.0]);
    }

    #[test]
    fn bootstrap_value_is_zero_after_success_alone() {
        let last = [Status::Success, Status::TimeLimit, Status::Running].map(|status| bootstrap_value(status, 3.0));
        assert_eq!(last, [0.0, 3.0, 3.0]);
    }

    #[test]
    fn normalized_values_have_zero_mean_and_unit_deviation() {
        // Mean 2, population deviation 1.
        let mut values = [1.0, 3.0, 1.0, 3.0];
        normalize(&mut values);
        for (x, expected) in values.iter().zip([-1.0, 1.0, -1.0, 1.0]) {
            assert!((x - expected).abs() < 1e-6);
        }
        let mut constant = [5.0; 3];
        normalize(&mut constant);
        assert_eq!(constant, [0.0; 3]);
    }
}

//! Metrics for the tests of what is watched, as they come from the bus.

use bus::MetricsSample;
use serde_json::Value;

/// Metrics of the learner.
pub(super) fn learner() -> MetricsSample {
    sample("learner", include_str!("../../tests/metrics/learner.json"))
}

/// An evaluation of two groups.
pub(super) fn evaluation() -> MetricsSample {
    sample("eval/summary", include_str!("../../tests/metrics/eval-summary.json"))
}

/// An actor's metrics under this name.
pub(super) fn actor(id: &str) -> MetricsSample {
    let mut actor = sample(&format!("actor/{id}"), include_str!("../../tests/metrics/actor.json"));
    actor.value["actor"] = id.into();
    actor
}

/// A result of one training blueprint: `n_successes` of 40 episodes with mode actions.
pub(super) fn blueprint(id: &str, n_successes: u64) -> MetricsSample {
    let mut blueprint = sample(&format!("eval/train/{id}"), include_str!("../../tests/metrics/eval-blueprint.json"));
    blueprint.value["blueprint"] = id.into();
    let success = &mut blueprint.value["mode"]["success"];
    success["n_successes"] = n_successes.into();
    success["rate"] = (n_successes as f64 / 40.0).into();
    blueprint
}

fn sample(suffix: &str, json: &str) -> MetricsSample {
    let value: Value = serde_json::from_str(json).unwrap();
    MetricsSample { suffix: suffix.to_owned(), value }
}

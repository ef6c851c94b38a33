//! Sample bus messages for tests.

use bus::MetricsSample;
use serde_json::Value;

use crate::run_view::{Roster, SessionState};

/// Metrics of the learner.
pub(crate) fn learner() -> MetricsSample {
    sample("learner", include_str!("../../tests/metrics/learner.json"))
}

/// Metrics of a learner with the mixture head.
pub(crate) fn mixture_learner() -> MetricsSample {
    let mut learner = learner();
    let kind = |n_draws: u64, n_tries: u64, success: Option<f64>| serde_json::json!({ "n_draws": n_draws, "share": n_draws as f64 / 200.0, "n_tries": n_tries, "success": success });
    learner.value["proposals"] = serde_json::json!({
        "first_proposal_entropy": 1.5, "second_block_entropy": 1.25, "second_proposal_entropy": 0.75,
        "kinds": {
            "join": kind(150, 80, Some(0.125)), "detach": kind(10, 10, Some(0.4)), "hold": kind(40, 0, None),
            "of a later version": kind(0, 0, None),
        },
    });
    learner
}

/// An evaluation of two groups.
pub(crate) fn evaluation() -> MetricsSample {
    sample("eval/summary", include_str!("../../tests/metrics/eval-summary.json"))
}

/// Metrics of the actor named `id`.
pub(crate) fn actor(id: &str) -> MetricsSample {
    let mut actor = sample(&format!("actor/{id}"), include_str!("../../tests/metrics/actor.json"));
    actor.value["actor"] = id.into();
    actor
}

/// A result of one training blueprint: `n_successes` of 40 episodes with greedy actions.
pub(crate) fn blueprint(id: &str, n_successes: u64) -> MetricsSample {
    let mut blueprint = sample(&format!("eval/train/{id}"), include_str!("../../tests/metrics/eval-blueprint.json"));
    blueprint.value["blueprint"] = id.into();
    let success = &mut blueprint.value["greedy"]["success"];
    success["n_successes"] = n_successes.into();
    success["rate"] = (n_successes as f64 / 40.0).into();
    blueprint
}

/// A session connected to a learner, an evaluator and these actors.
pub(crate) fn session(actors: &[&str]) -> SessionState {
    let names = |names: &[&str]| names.iter().map(|&name| name.to_owned()).collect();
    let roster = Roster { actors: names(actors), learners: names(&["learner"]), evaluators: names(&["evaluator"]) };
    SessionState { is_connected: true, roster, ..SessionState::default() }
}

/// A session without a connection.
pub(crate) fn cut_off() -> SessionState {
    SessionState::default()
}

fn sample(suffix: &str, json: &str) -> MetricsSample {
    let value: Value = serde_json::from_str(json).unwrap();
    MetricsSample { suffix: suffix.to_owned(), value }
}

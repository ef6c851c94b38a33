//! Recent history of a run's metrics, for sparklines.

use std::collections::VecDeque;

use proto::metrics::{EvalOutcome, EvalSummary, LearnerMetrics};

use super::proposals::{CHARTED, Look};

/// Number of newest values kept per trend.
const MAX_VALUES: usize = 200;

/// Learner metrics that are tracked, by name; those of [`CHARTED`] follow them.
const FOLLOWED: [(&str, Look); 9] = [
    ("success of episodes", |learner| {
        let success = &learner.episodes.success;
        (success.n_episodes > 0).then_some(success.rate)
    }),
    ("steps per second", |learner| Some(learner.env_steps_per_s)),
    ("lag, versions", |learner| Some(learner.policy_lag_mean)),
    ("policy loss", |learner| Some(learner.ppo.policy_loss)),
    ("value loss", |learner| Some(learner.ppo.value_loss)),
    ("entropy, nats", |learner| Some(learner.ppo.entropy)),
    ("KL of an update, nats", |learner| Some(learner.ppo.approx_kl)),
    ("explained variance", |learner| Some(learner.ppo.explained_variance)),
    ("gradient norm", |learner| Some(learner.ppo.grad_norm)),
];

/// The newest values of all tracked metrics.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Trends {
    evaluated: VecDeque<f64>,
    learned: [VecDeque<f64>; FOLLOWED.len() + CHARTED.len()],
}

impl Trends {
    /// Records a learner update.
    pub(super) fn learned(&mut self, learner: &LearnerMetrics) {
        for (values, (_, look)) in self.learned.iter_mut().zip(followed()) {
            push(values, look(learner));
        }
    }

    /// Records an evaluation that has ended. The first episodes of one say little.
    pub(super) fn evaluated(&mut self, summary: &EvalSummary) {
        if summary.is_complete {
            push(&mut self.evaluated, success_rate(&summary.all.greedy, &summary.all.sampled));
        }
    }

    /// Returns the names and values, oldest first, of all trends that have values.
    pub(crate) fn all(&self) -> impl Iterator<Item = (&'static str, &VecDeque<f64>)> {
        let learned = followed().zip(&self.learned).map(|((name, _), values)| (name, values));
        [("success, evaluated", &self.evaluated)].into_iter().chain(learned).filter(|(_, values)| !values.is_empty())
    }
}

fn followed() -> impl Iterator<Item = (&'static str, Look)> {
    FOLLOWED.into_iter().chain(CHARTED.into_iter().map(|(_, name, look)| (name, look)))
}

fn push(values: &mut VecDeque<f64>, value: Option<f64>) {
    let Some(value) = value.filter(|value| value.is_finite()) else { return };
    if values.len() >= MAX_VALUES {
        values.pop_front();
    }
    values.push_back(value);
}

/// Returns the success rate with greedy actions, or with sampled ones if no greedy episodes were run, 0 to 1; `None`
/// without episodes.
pub fn success_rate(greedy: &EvalOutcome, sampled: &EvalOutcome) -> Option<f64> {
    let rates = [&greedy.success, &sampled.success];
    rates.into_iter().find(|success| success.n_episodes > 0).map(|success| success.rate)
}

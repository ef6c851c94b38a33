//! How the numbers of a run went while it was watched, for small pictures.

use std::collections::VecDeque;

use proto::metrics::{EvalSummary, LearnerMetrics};

/// Values of a trend that are kept, the newest.
const MAX_VALUES: usize = 200;

/// What is followed in the learner's metrics, under its name on the page; nothing where it does not apply.
type Look = fn(&LearnerMetrics) -> Option<f64>;
const FOLLOWED: [(&str, Look); 12] = [
    ("success of episodes", |learner| {
        let success = &learner.episodes.success;
        (success.n_episodes > 0).then_some(success.rate)
    }),
    ("steps per second", |learner| Some(learner.env_steps_per_s)),
    ("block accuracy", |learner| labels(learner).map(|imitation| imitation.block_accuracy)),
    ("block loss, nats", |learner| labels(learner).map(|imitation| imitation.block_loss)),
    ("move loss", |learner| labels(learner).map(|imitation| imitation.move_loss)),
    ("lag, versions", |learner| Some(learner.policy_lag_mean)),
    ("policy loss", |learner| of_rewards(learner.ppo.policy_loss)),
    ("value loss", |learner| of_rewards(learner.ppo.value_loss)),
    ("entropy, nats", |learner| of_rewards(learner.ppo.entropy)),
    ("KL of an update, nats", |learner| of_rewards(learner.ppo.approx_kl)),
    ("explained variance", |learner| of_rewards(learner.ppo.explained_variance)),
    ("gradient norm", |learner| of_rewards(learner.ppo.grad_norm)),
];

/// The newest values of everything that is followed.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Trends {
    evaluated: VecDeque<f64>,
    learned: [VecDeque<f64>; FOLLOWED.len()],
}

impl Trends {
    /// Takes an update of the learner.
    pub(super) fn learned(&mut self, learner: &LearnerMetrics) {
        for (values, (_, look)) in self.learned.iter_mut().zip(FOLLOWED) {
            push(values, look(learner));
        }
    }

    /// Takes an evaluation.
    pub(super) fn evaluated(&mut self, summary: &EvalSummary) {
        let success = [&summary.all.mode.success, &summary.all.sampled.success];
        push(
            &mut self.evaluated,
            success.into_iter().find(|success| success.n_episodes > 0).map(|success| success.rate),
        );
    }

    /// Names and values, the oldest first, of everything that has any.
    pub(crate) fn all(&self) -> impl Iterator<Item = (&'static str, &VecDeque<f64>)> {
        let learned = FOLLOWED.iter().zip(&self.learned).map(|((name, _), values)| (*name, values));
        [("success, evaluated", &self.evaluated)].into_iter().chain(learned).filter(|(_, values)| !values.is_empty())
    }
}

/// Imitation, where labels teach.
fn labels(learner: &LearnerMetrics) -> Option<&proto::metrics::ImitationMetrics> {
    learner.imitation.as_ref().filter(|imitation| imitation.weight > 0.0)
}

/// A number of PPO's, which is exactly zero only where rewards teach nothing.
fn of_rewards(value: f64) -> Option<f64> {
    (value != 0.0).then_some(value)
}

fn push(values: &mut VecDeque<f64>, value: Option<f64>) {
    let Some(value) = value.filter(|value| value.is_finite()) else { return };
    if values.len() >= MAX_VALUES {
        values.pop_front();
    }
    values.push_back(value);
}

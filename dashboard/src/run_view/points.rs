//! Numbers of the learner over time, thinned out: the curves of the page, and the sparklines of the terminal.

use policy::proposals::Kind;
use proto::metrics::{KindMetrics, LearnerMetrics};
use serde_json::{Value, json};

/// Maximum number of kept points. Beyond it, every second one is removed.
const MAX_POINTS: usize = 600;

/// Returns a number of an update; `None` where it does not apply.
type Look = fn(&LearnerMetrics) -> Option<f64>;

/// Charted numbers: name in `/api/history`, name for people, and value; `None` where there is nothing to chart. Only the
/// mixture head has draws.
const CHARTED: [(&str, &str, Look); 18] = [
    ("success", "success of episodes", |l| has_ended(l).then_some(l.episodes.success.rate)),
    ("return", "return of episodes", |l| has_ended(l).then(|| l.episodes.mean_return.total().into())),
    ("env_steps_per_s", "steps per second", |l| Some(l.env_steps_per_s)),
    ("policy_lag_mean", "lag, versions", |l| Some(l.policy_lag_mean)),
    ("policy_loss", "policy loss", |l| Some(l.ppo.policy_loss)),
    ("value_loss", "value loss", |l| Some(l.ppo.value_loss)),
    ("entropy", "entropy, nats", |l| Some(l.ppo.entropy)),
    ("approx_kl", "KL of an update, nats", |l| Some(l.ppo.approx_kl)),
    ("explained_variance", "explained variance", |l| Some(l.ppo.explained_variance)),
    ("grad_norm", "gradient norm", |l| Some(l.ppo.grad_norm)),
    ("share_join", "share of join", |l| Some(drawn(l, Kind::Join)?.share)),
    ("share_detach", "share of detach", |l| Some(drawn(l, Kind::Detach)?.share)),
    ("share_hold", "share of hold", |l| Some(drawn(l, Kind::Hold)?.share)),
    ("success_join", "success of join", |l| drawn(l, Kind::Join)?.success),
    ("success_detach", "success of detach", |l| drawn(l, Kind::Detach)?.success),
    ("first_proposal_entropy", "entropy 1st proposal", |l| l.proposals.as_ref().map(|p| p.first_proposal_entropy)),
    ("second_block_entropy", "entropy 2nd block", |l| l.proposals.as_ref().map(|p| p.second_block_entropy)),
    ("second_proposal_entropy", "entropy 2nd proposal", |l| l.proposals.as_ref().map(|p| p.second_proposal_entropy)),
];

/// Updates of the learner, with increasing environment steps.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Points {
    kept: Vec<Point>,
    /// The newest, kept or not.
    newest: Option<Point>,
    /// Number of updates skipped between two kept ones.
    n_skipped: usize,
    n_seen: usize,
}

/// A learner update: its environment steps, and the charted values.
#[derive(Clone, Debug, PartialEq)]
struct Point(u64, Value);

impl Points {
    /// Returns the points that are kept, and the newest one, which is how a finished run ended.
    pub(crate) fn all(&self) -> impl Iterator<Item = &Value> {
        let is_new = |newest: &&Point| self.kept.last().is_none_or(|last| last.0 < newest.0);
        self.kept.iter().chain(self.newest.iter().filter(is_new)).map(|point| &point.1)
    }

    /// Returns the charted numbers, each with its name for people and its values, oldest first.
    pub(crate) fn charted(&self) -> impl Iterator<Item = (&'static str, Vec<f64>)> {
        let values = |key: &str| self.all().filter_map(|point| point[key].as_f64()).collect();
        CHARTED.into_iter().map(move |(key, name, _)| (name, values(key)))
    }

    /// Adds an update and drops those that it repeats: a learner may restart from an older checkpoint or from scratch,
    /// and one that waits for its disk reports the same update again.
    pub(crate) fn push(&mut self, learner: &LearnerMetrics) {
        self.kept.retain(|point| point.0 < learner.n_env_steps);
        self.n_seen += 1;
        let mut value = json!({
            "elapsed_s": learner.elapsed_s.max(learner.run_elapsed_s),
            "n_env_steps": learner.n_env_steps,
            "n_episodes": learner.n_episodes,
            "weights_version": learner.weights_version.0,
            "success": null,
            "return": null,
        });
        for (name, number) in CHARTED.iter().filter_map(|&(name, _, look)| Some((name, look(learner)?))) {
            value[name] = number.into();
        }
        let point = Point(learner.n_env_steps, value);
        self.newest = Some(point.clone());
        if !self.n_seen.is_multiple_of(self.n_skipped + 1) {
            return;
        }
        self.kept.push(point);
        if self.kept.len() > MAX_POINTS {
            let mut place = 0;
            self.kept.retain(|_| {
                place += 1;
                place % 2 == 0
            });
            self.n_skipped = 2 * self.n_skipped + 1;
        }
    }
}

fn has_ended(learner: &LearnerMetrics) -> bool {
    learner.episodes.success.n_episodes > 0
}

fn drawn(learner: &LearnerMetrics, kind: Kind) -> Option<&KindMetrics> {
    learner.proposals.as_ref()?.kinds.get(kind.name())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::samples;

    fn push(points: &mut Points, sample: &Value) {
        points.push(&serde_json::from_value(sample.clone()).unwrap());
    }

    #[test]
    fn points_count_the_time_before_a_resume() {
        let mut points = Points::default();
        let mut learner = samples::learner().value;
        push(&mut points, &learner);
        learner["n_env_steps"] = 4_000_000.into();
        learner["run_elapsed_s"] = 5000.into();
        push(&mut points, &learner);
        assert_eq!(points.all().map(|point| &point["elapsed_s"]).collect::<Vec<_>>(), [2520.5, 5000.0]);
    }

    #[test]
    fn points_have_the_draws_of_the_mixture_head() {
        let mut points = Points::default();
        push(&mut points, &samples::mixture_learner().value);
        let point = points.all().next().unwrap();
        assert_eq!([&point["success"], &point["return"]], [0.5, 3.25]);
        for (name, value) in [("share_hold", 0.2), ("success_join", 0.125), ("second_proposal_entropy", 0.75)] {
            assert_eq!(point[name], value, "{point}");
        }
        assert_eq!(point.get("success_hold"), None);
    }

    #[test]
    fn many_updates_are_thinned_and_end_with_the_last_one() {
        let mut points = Points::default();
        let mut learner = samples::learner().value;
        let n_updates = 2 * MAX_POINTS as u64 + 7;
        for update in 1..=n_updates {
            learner["n_env_steps"] = (100 * update).into();
            push(&mut points, &learner);
        }
        let steps: Vec<u64> = points.all().map(|point| point["n_env_steps"].as_u64().unwrap()).collect();
        assert!(steps.len() <= MAX_POINTS + 1 && steps.is_sorted());
        assert_eq!(steps.last(), Some(&(100 * n_updates)));
    }
}

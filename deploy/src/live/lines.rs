//! Metrics as text.

use std::time::Duration;

use dashboard::terminal::seconds;
use dashboard::{Sizes, waits};
use evaluator::EvaluationProgress;
use proto::metrics::{ActorMetrics, LearnerMetrics};

/// What a line about the learner needs in addition to its metrics.
#[derive(Clone, Debug, Default)]
pub(super) struct Context {
    /// Total environment steps of the run.
    pub(super) n_env_steps: u64,
    pub(super) n_actors: usize,
    /// Seconds left at the current pace.
    pub(super) left_s: Option<f64>,
    /// Success of the newest training episodes by number of blocks.
    pub(super) sizes: Sizes,
    /// Success rate of the last evaluation, 0 to 1.
    pub(super) evaluated: Option<f64>,
}

/// Pace of a run, measured from the first metrics seen.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pace {
    first: Option<(f64, u64)>,
}

impl Pace {
    /// Estimates the seconds from these metrics until the run reaches `n_env_steps`; `None` for the first metrics.
    pub(super) fn left_s(&mut self, learner: &LearnerMetrics, n_env_steps: u64) -> Option<f64> {
        let (since_s, since_steps) = *self.first.get_or_insert((learner.elapsed_s, learner.n_env_steps));
        let seconds = learner.elapsed_s - since_s;
        let n_steps = learner.n_env_steps.checked_sub(since_steps)?;
        let n_left = n_env_steps.saturating_sub(learner.n_env_steps);
        (seconds > 0.0 && n_steps > 0).then(|| seconds * n_left as f64 / n_steps as f64)
    }
}

/// One line with the progress of training, what is learned, and the throughput.
pub(super) fn learner(learner: &LearnerMetrics, context: &Context) -> String {
    // The last update may exceed the total.
    let percent = (100.0 * learner.n_env_steps as f64 / context.n_env_steps.max(1) as f64).min(100.0);
    let minutes = learner.elapsed_s.max(learner.run_elapsed_s) / 60.0;
    let parts = parts(learner, context).join("  ");
    format!("{minutes:6.1} min  {:>9} steps ({percent:3.0} %)  {parts}", learner.n_env_steps)
}

/// How episodes end, also by size, what the update did, and the throughput with the time left: one line each under the
/// bar, of at most 80 characters.
pub(super) fn parts(learner: &LearnerMetrics, context: &Context) -> Vec<String> {
    let episodes = &learner.episodes;
    let mut outcome = if episodes.success.n_episodes == 0 {
        let when = if learner.n_episodes == 0 { "yet" } else { "in this update" };
        format!("no episode of the policy ended {when}")
    } else {
        let rate = 100.0 * episodes.success.rate;
        let n_episodes = episodes.success.n_episodes;
        format!("success {rate:5.1} % of {n_episodes} episodes  return {:6.2}", episodes.mean_return.total())
    };
    if let Some(evaluated) = context.evaluated {
        outcome += &format!("  evaluated {:.1} %", 100.0 * evaluated);
    }
    let mut parts: Vec<String> = learner.not_saved.iter().map(waits).collect();
    parts.push(outcome);
    parts.extend(context.sizes.text().map(|sizes| format!("by blocks: {sizes}")));
    let ppo = &learner.ppo;
    parts.push(format!(
        "lag {:.1}  kl {:.4}  clip {:.2}  entropy {:.2}  explained variance {:.2}",
        learner.policy_lag_mean, ppo.approx_kl, ppo.clip_fraction, ppo.entropy, ppo.explained_variance,
    ));
    let actors = if context.n_actors == 1 { "actor" } else { "actors" };
    let (rate, steps_per_s) = (ppo.learning_rate, learner.env_steps_per_s);
    let mut pace = format!("lr {rate:.1e}  {steps_per_s:.0} steps/s  {} {actors}", context.n_actors);
    if let Some(left) = context.left_s {
        pace += &format!("  {} left", seconds(left));
    }
    parts.push(pace);
    parts
}

pub(super) fn actor(actor: &ActorMetrics) -> String {
    let learner = if actor.learner_is_there { "" } else { "  no learner is there" };
    format!(
        "{:6.1} min  {:>9} steps  {} episodes  {:.0} steps/s  lag {}  {} segments taken by the learner{learner}",
        actor.elapsed_s / 60.0,
        actor.n_env_steps,
        actor.n_episodes,
        actor.env_steps_per_s,
        actor.policy_lag,
        actor.n_trajectories_acked,
    )
}

/// Success rate of the episodes so far, and the time left at this pace. Empty before the first one has ended.
pub(super) fn so_far(progress: &EvaluationProgress, elapsed: Duration) -> String {
    let &EvaluationProgress { n_ended, n_successes, n_planned } = progress;
    if n_ended == 0 {
        return String::new();
    }
    let percent = 100.0 * n_successes as f64 / n_ended as f64;
    let left_s = elapsed.as_secs_f64() * n_planned.saturating_sub(n_ended) as f64 / n_ended as f64;
    format!("success {percent:.1} %  {} left", seconds(left_s))
}

#[cfg(test)]
mod tests {
    use proto::metrics::{EpisodeMetrics, PpoMetrics};
    use proto::wilson::SuccessRate;

    use super::*;

    fn metrics() -> LearnerMetrics {
        let sample = include_str!("../../../dashboard/tests/metrics/learner.json");
        LearnerMetrics {
            n_env_steps: 1500,
            n_episodes: 0,
            elapsed_s: 90.0,
            env_steps_per_s: 12.4,
            policy_lag_mean: 0.5,
            ppo: PpoMetrics { explained_variance: 0.25, learning_rate: 1e-3, ..PpoMetrics::default() },
            episodes: EpisodeMetrics::default(),
            ..serde_json::from_str(sample).unwrap()
        }
    }

    #[test]
    fn a_line_has_the_progress_the_update_and_the_pace() {
        let context = Context { n_env_steps: 3000, n_actors: 1, ..Context::default() };
        assert_eq!(
            learner(&metrics(), &context),
            "   1.5 min       1500 steps ( 50 %)  no episode of the policy ended yet  lag 0.5  kl 0.0000  clip 0.00  \
             entropy 0.00  explained variance 0.25  lr 1.0e-3  12 steps/s  1 actor"
        );
    }

    #[test]
    fn a_lull_in_episodes_does_not_deny_those_before() {
        let mut learner = metrics();
        learner.n_episodes = 97;
        assert_eq!(parts(&learner, &Context::default())[0], "no episode of the policy ended in this update");
    }

    #[test]
    fn lines_under_the_bar_fit_into_80_columns() {
        let mut learner = metrics();
        learner.episodes.success = SuccessRate::new(9999, 9999);
        learner.ppo.entropy = 12.34;
        learner.ppo.explained_variance = -0.25;
        let mut context = Context { n_actors: 999, left_s: Some(5000.0), evaluated: Some(1.0), ..Context::default() };
        let sizes = ["11_000", "12_000", "13_000", "14_000", "15_000", "16_000", "mine"];
        let rates = sizes.map(|id| (id.parse().unwrap(), SuccessRate::new(100, 100)));
        learner.episodes.success_by_blueprint = rates.into();
        context.sizes.add(&learner);
        assert!(parts(&learner, &context)[1].starts_with("by blocks: 11: 100  12: 100"));
        for part in parts(&learner, &context) {
            assert!(part.chars().count() <= 80, "{part}");
        }
    }

    #[test]
    fn a_run_that_cannot_save_says_so_first() {
        let mut learner = metrics();
        let reason = "cannot write runs/a/metrics.jsonl: No space left on device".to_owned();
        learner.not_saved = Some(proto::metrics::NotSaved { since_unix_ms: 1_769_846_700_999, reason: reason.clone() });
        let parts = parts(&learner, &Context::default());
        assert_eq!(parts[0], format!("training waits: not saved since 2026-01-31 08:05 UTC: {reason}"));
    }

    #[test]
    fn what_is_left_is_told_from_the_pace_since_the_first_look() {
        let mut pace = Pace::default();
        let mut learner = metrics();
        assert_eq!(pace.left_s(&learner, 3000), None);
        // 500 steps in 50 s, with 1000 left.
        (learner.n_env_steps, learner.elapsed_s) = (2000, 140.0);
        assert_eq!(pace.left_s(&learner, 3000), Some(100.0));
        (learner.n_env_steps, learner.elapsed_s) = (4000, 200.0);
        assert_eq!(pace.left_s(&learner, 3000), Some(0.0));
    }

    #[test]
    fn success_and_rest_are_those_of_the_episodes_so_far() {
        // 20 episodes in 10 s, with 100 left.
        let progress = EvaluationProgress { n_ended: 20, n_successes: 5, n_planned: 120 };
        assert_eq!(so_far(&progress, Duration::from_secs(10)), "success 25.0 %  50 s left");
        let begun = EvaluationProgress { n_planned: 120, ..EvaluationProgress::default() };
        assert_eq!(so_far(&begun, Duration::from_secs(10)), "");
    }
}

//! Metrics as text.

use proto::metrics::LearnerMetrics;

/// One line with how far training is and its rates.
pub(super) fn learner(learner: &LearnerMetrics, n_actors: usize, n_env_steps: u64) -> String {
    let percent = 100.0 * learner.n_env_steps as f64 / n_env_steps.max(1) as f64;
    let minutes = learner.elapsed_s / 60.0;
    format!("{minutes:6.1} min  {:>9} steps ({percent:3.0} %)  {}", learner.n_env_steps, rates(learner, n_actors))
}

/// Returns, success, throughput, lag and the numbers of the update.
pub(super) fn rates(learner: &LearnerMetrics, n_actors: usize) -> String {
    let (episodes, ppo) = (&learner.episodes, &learner.ppo);
    let outcome = if episodes.success.n_episodes == 0 {
        "no episode ended".to_owned()
    } else {
        let (rate, n_episodes) = (100.0 * episodes.success.rate, episodes.success.n_episodes);
        format!("return {:6.2}  success {rate:5.1} % of {n_episodes}", episodes.mean_return.total())
    };
    format!(
        "{outcome}  {:.0} steps/s  {n_actors} actors  lag {:.1}  kl {:.4}  clipped {:.2}  entropy {:.2}  \
         explained variance {:.2}  lr {:.1e}",
        learner.env_steps_per_s,
        learner.policy_lag_mean,
        ppo.approx_kl,
        ppo.clip_fraction,
        ppo.entropy,
        ppo.explained_variance,
        ppo.learning_rate,
    )
}

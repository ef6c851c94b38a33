//! The evaluation itself: a frozen policy, blueprints, episodes with fixed seeds.

use std::sync::Arc;

use blueprints::Blueprint;
use proto::Weights;

use crate::pool::EvaluationPool;
use crate::report::{Episode, Judged, summarize};
use crate::reset_free;
use crate::sequences::EpisodeSpec;
use crate::setup::{EvalError, EvalSetup};
use crate::work_queue::WorkQueue;
use proto::metrics::EvalReport;

/// Episodes with each way of acting before an evaluation first says what it has found.
pub const FIRST_PART: usize = 32;

/// Judges `weights` on `blueprints`: `n_episodes` for each, once for each way of acting, and then
/// the reset-free runs if the setup has any.
///
/// Start states depend on seed, blueprint and number of the episode only: not on the weights, the other blueprints or
/// the way of acting. An episode that ends in success goes on for up to 10 steps with the grippers holding still, in
/// which the success can prove stable. The report's duration is left at 0. `keep_going` is asked at every step.
///
/// # Errors
/// When the weights do not fit, an episode cannot be started, or `keep_going` says no.
pub fn evaluate(
    setup: &EvalSetup<'_>,
    weights: &Weights,
    blueprints: &[&Blueprint],
    keep_going: &(dyn Fn() -> bool + Sync),
) -> Result<EvalReport, EvalError> {
    let queue = WorkQueue::new(Arc::new(weights.clone()));
    evaluate_in_parts(&EvaluationPool { setup, queue: &queue, films: None, keep_going }, blueprints, &mut |_| {})
}

/// Like [`evaluate`] with the weights of the pool's work queue, and tells `on_part` what the first episodes found: the first
/// [`FIRST_PART`] of them, then twice as many, and so on. Every part is spread over all blueprints, so that its groups are
/// fair samples of the whole. Episodes that the pool's films ask for are recorded; reset-free runs are not.
///
/// # Errors
/// As for [`evaluate`].
pub(crate) fn evaluate_in_parts(
    pool: &EvaluationPool<'_>,
    blueprints: &[&Blueprint],
    on_part: &mut dyn FnMut(EvalReport),
) -> Result<EvalReport, EvalError> {
    let (setup, weights) = (pool.setup, pool.queue.weights());
    let n_episodes = u64::from(setup.episodes.n_episodes);
    let (catalog, starts) = (setup.catalog, setup.episodes.starts);
    let sequence =
        |blueprint, episode_idx| vec![EpisodeSpec::one_of(catalog, blueprint, starts, setup.seed, episode_idx)];
    let spread = spread(blueprints);
    let sequences: Vec<Vec<EpisodeSpec>> = (0..n_episodes)
        .flat_map(|episode_idx| spread.iter().map(move |&blueprint| sequence(blueprint, episode_idx)))
        .collect();
    let report = |episodes: &[Episode], is_complete| {
        let (weights_version, n_env_steps, seed) = (weights.version, weights.n_env_steps, setup.seed);
        let n_planned = sequences.len() as u64;
        summarize(Judged { weights_version, n_env_steps, seed, n_planned, is_complete }, episodes)
    };
    let mut episodes = Vec::new();
    let mut n_run = 0;
    while n_run < sequences.len() {
        let part = &sequences[n_run..sequences.len().min(FIRST_PART.max(2 * n_run))];
        for &acting in &setup.episodes.acting {
            let results = pool.run(part, acting)?;
            episodes.extend(results.into_iter().flatten().map(|results| results.episode));
        }
        n_run += part.len();
        if n_run < sequences.len() {
            on_part(report(&episodes, false));
        }
    }
    let mut report = report(&episodes, true);
    if let Some(config) = &setup.reset_free {
        report.summary.reset_free = Some(reset_free::evaluate(&EvaluationPool { films: None, ..*pool }, config)?);
    }
    report.summary.n_assisted = pool.queue.n_assisted();
    Ok(report)
}

/// The same blueprints in an order in which the first few are spread over the list, which goes by split and size.
fn spread<'b>(blueprints: &[&'b Blueprint]) -> Vec<&'b Blueprint> {
    let stride = blueprints.len().div_ceil(FIRST_PART).max(1);
    (0..stride).flat_map(|first| blueprints.iter().skip(first).step_by(stride).copied()).collect()
}

#[cfg(test)]
pub(crate) mod tests;

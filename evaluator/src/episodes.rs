//! Evaluates an agent on blueprints, with fixed episode seeds.

use blueprints::Blueprint;
use proto::metrics::{EvalReport, EvalResetFree};
use proto::{ActionMode, Trajectory};
use tokio::sync::watch;

use crate::config::ResetFreeConfig;
use crate::endings::Endings;
use crate::pool::{EvaluationPool, EvaluationProgress};
use crate::recording::Recorder;
use crate::report::{EpisodeResult, summarize};
use crate::reset_free;
use crate::setup::{EvalError, EvalSetup, Performer};
use crate::spec::EpisodeSpec;

/// Number of episodes per action mode after which an evaluation first reports intermediate results.
pub const FIRST_PART: usize = 32;

/// What follows an evaluation, from the threads that run the episodes.
pub struct Follower<'a> {
    /// Called at every step; returning false interrupts the evaluation.
    pub keep_going: &'a (dyn Fn() -> bool + Sync),
    /// Gets the number of episodes, then counts each one that ends.
    pub progress: Option<&'a watch::Sender<Option<EvaluationProgress>>>,
    /// Counts how the episodes end, except in reset-free runs.
    pub endings: Option<&'a Endings>,
}

impl Default for Follower<'_> {
    /// Never interrupts, and ignores the results.
    fn default() -> Self {
        Self { keep_going: &|| true, progress: None, endings: None }
    }
}

/// Evaluates an agent on `blueprints`: `n_episodes` per blueprint in each action mode, followed by the reset-free runs
/// if the setup has any. The expert has one action mode, `greedy`, and no weights: its report has version 0.
///
/// Start states depend only on the seed, the blueprint, and the episode index, not on the weights, the other
/// blueprints, or the action mode. After a success, a copy of the world goes on for up to 10 steps with idle grippers,
/// to test whether the success is stable. The report's duration stays 0, because no clock is read. The report of an
/// interrupted evaluation is marked incomplete: it has the episodes so far, and no reset-free runs.
///
/// # Errors
/// If the weights do not fit or an episode cannot be started.
pub fn evaluate(
    setup: &EvalSetup<'_>,
    performer: Performer<'_>,
    blueprints: &[&Blueprint],
    follower: &Follower<'_>,
) -> Result<EvalReport, EvalError> {
    let mut setup = setup.clone();
    if matches!(performer, Performer::Expert) {
        setup.episodes.acting = vec![ActionMode::Greedy];
    }
    let &Follower { keep_going, progress, endings } = follower;
    let catalog = setup.catalog;
    let count = endings.map(|endings| {
        move |_: usize, episode: Trajectory, result: &EpisodeResult| endings.count(catalog, &episode, result)
    });
    let recorder = count.as_ref().map(|count| count as &dyn Recorder);
    let pool = EvaluationPool { setup: &setup, performer, recorder, progress, keep_going };
    evaluate_in_parts(&pool, blueprints, &mut drop)
}

/// Like [`evaluate()`] for the pool's performer. Reports intermediate results to `on_part`: of the first
/// [`FIRST_PART`] episodes, then of twice as many, and so on. Every part is spread over all blueprints, so its groups are
/// fair samples of the whole.
pub(crate) fn evaluate_in_parts(
    pool: &EvaluationPool<'_>,
    blueprints: &[&Blueprint],
    on_part: &mut dyn FnMut(EvalReport),
) -> Result<EvalReport, EvalError> {
    let setup = pool.setup;
    let n_episodes = u64::from(setup.episodes.n_episodes);
    let (catalog, starts) = (setup.catalog, setup.episodes.starts);
    let sequence =
        |blueprint, episode_idx| vec![EpisodeSpec::one_of(catalog, blueprint, starts, setup.seed, episode_idx)];
    let spread = spread(blueprints);
    let sequences: Vec<Vec<EpisodeSpec>> = (0..n_episodes)
        .flat_map(|episode_idx| spread.iter().map(move |&blueprint| sequence(blueprint, episode_idx)))
        .collect();
    let (version, n_env_steps) = match pool.performer {
        Performer::Expert => Default::default(),
        Performer::Policy(_, weights) => (weights.version, weights.n_env_steps),
    };
    let report = |episodes: &[EpisodeResult], is_complete| {
        let mut report = summarize(version, n_env_steps, episodes);
        report.summary.seed = setup.seed;
        report.summary.n_planned = sequences.len() as u64;
        report.summary.is_complete = is_complete;
        report
    };
    let n_reset_free = setup.reset_free.as_ref().map_or(0, ResetFreeConfig::n_episodes);
    pool.plan((sequences.len() as u64 + n_reset_free) * setup.episodes.acting.len() as u64);
    let mut episodes = Vec::new();
    let mut n_run = 0;
    let mut run_all = || -> Result<Option<EvalResetFree>, EvalError> {
        while n_run < sequences.len() {
            let part = &sequences[n_run..sequences.len().min(FIRST_PART.max(2 * n_run))];
            for &acting in &setup.episodes.acting {
                let (results, ended) = pool.run(part, acting);
                episodes.extend(results.into_iter().flatten());
                ended?;
            }
            n_run += part.len();
            if n_run < sequences.len() {
                on_part(report(&episodes, false));
            }
        }
        setup.reset_free.as_ref().map(|config| reset_free::evaluate(pool, config)).transpose()
    };
    let reset_free = match run_all() {
        Err(EvalError::Interrupted) => return Ok(report(&episodes, false)),
        ended => ended?,
    };
    let mut report = report(&episodes, true);
    report.summary.reset_free = reset_free;
    Ok(report)
}

/// Reorders the blueprints, which are sorted by split and size, so that the first few are spread over the whole list.
fn spread<'b>(blueprints: &[&'b Blueprint]) -> Vec<&'b Blueprint> {
    let stride = blueprints.len().div_ceil(FIRST_PART).max(1);
    (0..stride).flat_map(|first| blueprints.iter().skip(first).step_by(stride).copied()).collect()
}

#[cfg(test)]
pub(crate) mod tests;

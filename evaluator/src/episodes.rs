//! Evaluates a frozen policy on blueprints, with fixed episode seeds.

use blueprints::Blueprint;
use environment::ExpertAgent;
use policy::{Policy, PolicyConfig};
use proto::metrics::{EvalReport, EvalResetFree};
use proto::{ActionMode, Agent, Valid, Weights};

use crate::config::{EpisodeConfig, ResetFreeConfig};
use crate::endings::Endings;
use crate::follower::{Both, Follower};
use crate::performance::Performer;
use crate::pool::EvaluationPool;
use crate::report::{EpisodeResult, summarize};
use crate::reset_free;
use crate::sequences::{EpisodeObserver, EpisodeSpec};
use crate::setup::{EvalError, EvalSetup};

/// Number of episodes per action mode after which an evaluation first reports intermediate results.
pub const FIRST_PART: usize = 32;

/// Evaluates `weights` of a policy with this configuration on `blueprints`: `n_episodes` per blueprint in each action
/// mode, followed by the reset-free runs if the setup has any.
///
/// Start states depend only on the seed, the blueprint, and the episode index, not on the weights, the other
/// blueprints, or the action mode. After a success, a copy of the world goes on for up to 10 steps with idle grippers, to
/// test whether the success is stable. The report's duration stays 0, because no clock is read. `keep_going` is called
/// at every step.
///
/// # Errors
/// If the weights do not fit, an episode cannot be started, or `keep_going` returns false.
pub fn evaluate(
    setup: &EvalSetup<'_>,
    policy: &Valid<PolicyConfig>,
    weights: &Weights,
    blueprints: &[&Blueprint],
    keep_going: &(dyn Fn() -> bool + Sync),
) -> Result<EvalReport, EvalError> {
    let follower = Follower { keep_going, ..Follower::default() };
    let report = evaluate_followed(setup, Performer::Policy(policy, weights), blueprints, &follower, None)?;
    if report.summary.is_complete { Ok(report) } else { Err(EvalError::Interrupted) }
}

/// Like [`evaluate()`] for either agent, but calls `follower` for each episode, and returns a partial report when
/// `keep_going` returns false. A partial report is marked incomplete and has no reset-free runs. Counts in `endings`, if
/// given, how the episodes end, but not those of reset-free runs. The expert has one action mode, `greedy`, and no
/// weights: its report has version 0.
///
/// # Errors
/// If the weights do not fit or an episode cannot be started.
pub fn evaluate_followed(
    setup: &EvalSetup<'_>,
    performer: Performer<'_>,
    blueprints: &[&Blueprint],
    follower: &Follower<'_>,
    endings: Option<&Endings>,
) -> Result<EvalReport, EvalError> {
    match performer {
        Performer::Expert => {
            let episodes = EpisodeConfig { acting: vec![ActionMode::Greedy], ..setup.episodes.clone() };
            let setup = EvalSetup { episodes, ..setup.clone() };
            let agent = || Ok::<_, EvalError>(ExpertAgent::new(&setup.environment));
            evaluate_agent(&setup, &agent, None, blueprints, follower, endings)
        }
        Performer::Policy(policy, weights) => {
            let agent = || Policy::with_weights(policy, weights).map_err(EvalError::from);
            evaluate_agent(setup, &agent, Some(weights), blueprints, follower, endings)
        }
    }
}

fn evaluate_agent<A: Agent>(
    setup: &EvalSetup<'_>,
    agent: &(dyn Fn() -> Result<A, EvalError> + Sync),
    weights: Option<&Weights>,
    blueprints: &[&Blueprint],
    follower: &Follower<'_>,
    endings: Option<&Endings>,
) -> Result<EvalReport, EvalError>
where
    EvalError: From<A::Error>,
{
    let observer = Both(&endings, follower);
    let keep_going = follower.keep_going;
    let pool = EvaluationPool { setup, agent, observer: Some(&observer), progress: None, keep_going };
    let mut last_part = None;
    match evaluate_in_parts(&pool, weights, blueprints, &mut |part| last_part = Some(part)) {
        Err(EvalError::Interrupted) => last_part.ok_or(EvalError::Interrupted),
        ended => ended,
    }
}

/// Like [`evaluate`] with the agents of the pool, which act with `weights`, if they have any. Reports intermediate results
/// to `on_part`: of the first [`FIRST_PART`] episodes, then of twice as many, and so on. Every part is spread over all
/// blueprints, so its groups are fair samples of the whole. If the pool is interrupted, the last part covers all
/// episodes that have ended.
///
/// # Errors
/// As for [`evaluate`].
pub(crate) fn evaluate_in_parts<A: Agent, O: EpisodeObserver>(
    pool: &EvaluationPool<'_, A, O>,
    weights: Option<&Weights>,
    blueprints: &[&Blueprint],
    on_part: &mut dyn FnMut(EvalReport),
) -> Result<EvalReport, EvalError>
where
    EvalError: From<A::Error>,
{
    let setup = pool.setup;
    let n_episodes = u64::from(setup.episodes.n_episodes);
    let (catalog, starts) = (setup.catalog, setup.episodes.starts);
    let sequence =
        |blueprint, episode_idx| vec![EpisodeSpec::one_of(catalog, blueprint, starts, setup.seed, episode_idx)];
    let spread = spread(blueprints);
    let sequences: Vec<Vec<EpisodeSpec>> = (0..n_episodes)
        .flat_map(|episode_idx| spread.iter().map(move |&blueprint| sequence(blueprint, episode_idx)))
        .collect();
    let report = |episodes: &[EpisodeResult], is_complete| {
        let (version, n_env_steps) = weights.map_or_else(Default::default, |w| (w.version, w.n_env_steps));
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
        let runs = |config| reset_free::evaluate(pool, config, &setup.episodes.acting);
        setup.reset_free.as_ref().map(runs).transpose()
    };
    let ended = run_all();
    if let Err(EvalError::Interrupted) = ended {
        on_part(report(&episodes, false));
    }
    let mut report = report(&episodes, true);
    report.summary.reset_free = ended?;
    Ok(report)
}

/// Reorders the blueprints, which are sorted by split and size, so that the first few are spread over the whole list.
fn spread<'b>(blueprints: &[&'b Blueprint]) -> Vec<&'b Blueprint> {
    let stride = blueprints.len().div_ceil(FIRST_PART).max(1);
    (0..stride).flat_map(|first| blueprints.iter().skip(first).step_by(stride).copied()).collect()
}

#[cfg(test)]
pub(crate) mod tests;

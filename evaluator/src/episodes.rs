//! The evaluation itself: a frozen policy, blueprints, episodes with fixed seeds.

use blueprints::{Blueprint, BlueprintId, Catalogue};
use environment::{EnvironmentConfig, EnvironmentConfigError, ResetError, World};
use policy::{Policy, PolicyConfig, PolicyError};
use proto::Weights;

use crate::config::{EpisodeConfig, ResetFreeConfig};
use crate::films::Casting;
use crate::lanes::{Job, Played, Rules, run_lanes};
use crate::report::{Acting, Episode, EvalReport, Judged};
use crate::reset_free;

/// Episodes with each way of acting before an evaluation first says what it has found.
pub const FIRST_PART: usize = 32;

/// All that an evaluation needs besides weights and blueprints.
#[derive(Clone, Debug)]
pub struct EvalSetup<'c> {
    /// Where blueprints come from.
    pub catalogue: &'c Catalogue,
    /// The policy; it must be the learner's.
    pub policy: PolicyConfig,
    /// The world.
    pub environment: EnvironmentConfig,
    /// How episodes are run.
    pub episodes: EpisodeConfig,
    /// Reset-free runs as well, when given.
    pub reset_free: Option<ResetFreeConfig>,
    /// Seed of start states and sampled actions: passes with the same seed can be compared episode by episode.
    pub seed: u64,
}

/// Why an evaluation has no result.
#[derive(Debug, thiserror::Error)]
pub enum EvalError {
    /// The policy cannot be made or refuses the weights.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// The world cannot be made.
    #[error(transparent)]
    Environment(#[from] EnvironmentConfigError),
    /// A start state cannot be made.
    #[error("an episode of blueprint {blueprint} cannot be started")]
    Reset {
        /// The goal.
        blueprint: BlueprintId,
        /// Why.
        source: ResetError,
    },
    /// No training blueprint is large enough for the reset-free runs.
    #[error("no training blueprint has {min_blocks} blocks or more for the reset-free runs")]
    NoGoals {
        /// As configured.
        min_blocks: usize,
    },
    /// The caller asked for the end.
    #[error("the evaluation was interrupted")]
    Interrupted,
}

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
    evaluate_in_parts(setup, weights, blueprints, None, keep_going, &mut |_| {})
}

/// Like [`evaluate`], and tells `on_part` what the first episodes found: the first [`FIRST_PART`] of them, then twice as
/// many, and so on. Every part is spread over all blueprints, so that its groups are fair samples of the whole. Episodes that
/// `films` asks for are recorded; reset-free runs are not.
///
/// # Errors
/// As for [`evaluate`].
pub fn evaluate_in_parts(
    setup: &EvalSetup<'_>,
    weights: &Weights,
    blueprints: &[&Blueprint],
    films: Option<&Casting>,
    keep_going: &(dyn Fn() -> bool + Sync),
    on_part: &mut dyn FnMut(EvalReport),
) -> Result<EvalReport, EvalError> {
    let n_episodes = u64::from(setup.episodes.n_episodes);
    let (catalogue, starts) = (setup.catalogue, setup.episodes.starts);
    let lane = |blueprint, episode_idx| vec![Job::one_of(catalogue, blueprint, starts, setup.seed, episode_idx)];
    let spread = spread(blueprints);
    let lanes: Vec<Vec<Job>> = (0..n_episodes)
        .flat_map(|episode_idx| spread.iter().map(move |&blueprint| lane(blueprint, episode_idx)))
        .collect();
    let report = |episodes: &[Episode], is_complete| {
        let (weights_version, n_env_steps, seed) = (weights.version, weights.n_env_steps, setup.seed);
        let n_planned = lanes.len() as u64;
        EvalReport::new(Judged { weights_version, n_env_steps, seed, n_planned, is_complete }, episodes)
    };
    let mut episodes = Vec::new();
    let mut n_played = 0;
    while n_played < lanes.len() {
        let part = &lanes[n_played..lanes.len().min(FIRST_PART.max(2 * n_played))];
        for &acting in &setup.episodes.acting {
            let played = run_all(setup, weights, part, acting, films, keep_going)?;
            episodes.extend(played.into_iter().flatten().map(|played| played.episode));
        }
        n_played += part.len();
        if n_played < lanes.len() {
            on_part(report(&episodes, false));
        }
    }
    let mut report = report(&episodes, true);
    if let Some(config) = &setup.reset_free {
        report.summary.reset_free = Some(reset_free::evaluate(setup, config, weights, keep_going)?);
    }
    Ok(report)
}

/// The same blueprints in an order in which the first few are spread over the list, which goes by split and size.
fn spread<'b>(blueprints: &[&'b Blueprint]) -> Vec<&'b Blueprint> {
    let stride = blueprints.len().div_ceil(FIRST_PART).max(1);
    (0..stride).flat_map(|first| blueprints.iter().skip(first).step_by(stride).copied()).collect()
}

/// Runs the lanes with the policy; the results have the shape of `lanes`.
pub(crate) fn run_all(
    setup: &EvalSetup<'_>,
    weights: &Weights,
    lanes: &[Vec<Job>],
    acting: Acting,
    films: Option<&Casting>,
    keep_going: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<Vec<Played>>, EvalError> {
    share_out(lanes, setup.episodes.n_threads, |lanes| {
        let mut policy = Policy::new(&setup.policy)?;
        policy.load(weights)?;
        let n_worlds = setup.episodes.n_worlds.min(lanes.len());
        let worlds: Result<Vec<World>, _> = (0..n_worlds).map(|_| World::new(&setup.environment)).collect();
        let success = &setup.environment.success;
        let rules = Rules { catalogue: setup.catalogue, acting, success, keep_going, films };
        run_lanes(&rules, &policy, worlds?, lanes)
    })
}

/// Shares the lanes out among threads; the results are in the order of the lanes.
pub(crate) fn share_out<T: Send>(
    lanes: &[Vec<Job>],
    n_threads: usize,
    run: impl Fn(&[Vec<Job>]) -> Result<Vec<T>, EvalError> + Sync,
) -> Result<Vec<T>, EvalError> {
    if n_threads <= 1 {
        return run(lanes);
    }
    // Dealt out in turn, because neighbours cost alike.
    let n_shares = n_threads.min(lanes.len()).max(1);
    let shares: Vec<Vec<Vec<Job>>> =
        (0..n_shares).map(|first| lanes.iter().skip(first).step_by(n_shares).cloned().collect()).collect();
    std::thread::scope(|scope| {
        let run = &run;
        let threads: Vec<_> = shares.iter().map(|lanes| scope.spawn(move || run(lanes))).collect();
        let mut piles = Vec::with_capacity(n_shares);
        for thread in threads {
            piles.push(thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?.into_iter());
        }
        Ok((0..lanes.len()).filter_map(|lane_idx| piles[lane_idx % n_shares].next()).collect())
    })
}

#[cfg(test)]
pub(crate) mod tests;

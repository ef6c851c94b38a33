//! The evaluation itself: a frozen policy, blueprints, episodes with fixed seeds.

use std::sync::Arc;
use std::time::Duration;

use blueprints::{Blueprint, BlueprintId, Catalogue};
use environment::{EnvironmentConfig, EnvironmentConfigError, ResetError, World};
use policy::{Policy, PolicyConfig, PolicyError};
use proto::Weights;

use crate::config::{EpisodeConfig, ResetFreeConfig};
use crate::desk::Desk;
use crate::films::Casting;
use crate::lanes::{Job, Played, Rules, run_lanes};
use crate::report::{Acting, Episode, EvalReport, Judged};
use crate::reset_free;

/// Episodes with each way of acting before an evaluation first says what it has found.
pub const FIRST_PART: usize = 32;

/// How long threads without work wait before they ask whether to go on.
const PATIENCE: Duration = Duration::from_millis(100);

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
    let desk = Desk::new(Arc::new(weights.clone()));
    evaluate_in_parts(&Workshop { setup, desk: &desk, films: None, keep_going }, blueprints, &mut |_| {})
}

/// Like [`evaluate`] with the weights of the workshop's desk, and tells `on_part` what the first episodes found: the first
/// [`FIRST_PART`] of them, then twice as many, and so on. Every part is spread over all blueprints, so that its groups are
/// fair samples of the whole. Episodes that the workshop's films ask for are recorded; reset-free runs are not.
///
/// # Errors
/// As for [`evaluate`].
pub(crate) fn evaluate_in_parts(
    workshop: &Workshop<'_>,
    blueprints: &[&Blueprint],
    on_part: &mut dyn FnMut(EvalReport),
) -> Result<EvalReport, EvalError> {
    let (setup, weights) = (workshop.setup, workshop.desk.weights());
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
            let played = workshop.run(part, acting)?;
            episodes.extend(played.into_iter().flatten().map(|played| played.episode));
        }
        n_played += part.len();
        if n_played < lanes.len() {
            on_part(report(&episodes, false));
        }
    }
    let mut report = report(&episodes, true);
    if let Some(config) = &setup.reset_free {
        report.summary.reset_free = Some(reset_free::evaluate(&Workshop { films: None, ..*workshop }, config)?);
    }
    report.summary.n_assisted = workshop.desk.n_assisted();
    Ok(report)
}

/// The same blueprints in an order in which the first few are spread over the list, which goes by split and size.
fn spread<'b>(blueprints: &[&'b Blueprint]) -> Vec<&'b Blueprint> {
    let stride = blueprints.len().div_ceil(FIRST_PART).max(1);
    (0..stride).flat_map(|first| blueprints.iter().skip(first).step_by(stride).copied()).collect()
}

/// Runs lanes with frozen weights, by threads of this process and whoever else takes some from the desk. Only episodes of
/// this process become films.
#[derive(Clone, Copy)]
pub(crate) struct Workshop<'a> {
    pub(crate) setup: &'a EvalSetup<'a>,
    pub(crate) desk: &'a Desk,
    pub(crate) films: Option<&'a Casting>,
    pub(crate) keep_going: &'a (dyn Fn() -> bool + Sync),
}

impl Workshop<'_> {
    /// Runs the lanes; the results have their shape.
    pub(crate) fn run(&self, lanes: &[Vec<Job>], acting: Acting) -> Result<Vec<Vec<Played>>, EvalError> {
        self.desk.post(lanes, acting);
        let n_threads = self.setup.episodes.n_threads.min(lanes.len()).max(1);
        let n_worlds = self.setup.episodes.n_worlds.min(lanes.len().div_ceil(n_threads));
        let ended: Result<(), EvalError> = std::thread::scope(|scope| {
            let others: Vec<_> = (1..n_threads).map(|_| scope.spawn(|| self.work(acting, n_worlds))).collect();
            let own = self.work(acting, n_worlds);
            let join = |thread: std::thread::ScopedJoinHandle<'_, _>| {
                thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
            };
            others.into_iter().map(join).fold(own, Result::and)
        });
        let played = self.desk.clear();
        ended.map(|()| played)
    }

    /// Takes lanes from the desk until all are done.
    fn work(&self, acting: Acting, n_worlds: usize) -> Result<(), EvalError> {
        let mut policy = Policy::new(&self.setup.policy)?;
        policy.load(self.desk.weights())?;
        let rules = Rules {
            catalogue: self.setup.catalogue,
            acting,
            success: &self.setup.environment.success,
            keep_going: self.keep_going,
            films: self.films,
        };
        loop {
            let worlds: Result<Vec<World>, _> = (0..n_worlds).map(|_| World::new(&self.setup.environment)).collect();
            let bring = |lane_idx, played| self.desk.bring(lane_idx, played);
            run_lanes(&rules, &policy, worlds?, || self.desk.take(), bring)?;
            if self.desk.is_done() {
                return Ok(());
            }
            // Others have the last lanes; if they do not bring them, somebody must run them.
            self.desk.wait(PATIENCE);
            if !(self.keep_going)() {
                return Err(EvalError::Interrupted);
            }
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;

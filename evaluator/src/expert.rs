//! The scripted expert judged as a policy is, and its failures explained.

mod diary;

use blueprints::{Blueprint, BlueprintId, Catalog, Split};
use environment::{Env, EnvironmentConfig, Expert, World};
use proto::metrics::{EvalOutcome, EvalResetFree, EvalRuns};
use proto::{Status, Trajectory};
use serde::{Deserialize, Serialize};

use crate::config::{ResetFreeConfig, Starts};
use crate::report::{Judged, summarize};
use crate::reset_free;
use crate::sequences::{EnvSlot, EpisodeResult, EpisodeSpec, Rules};
use crate::setup::EvalError;
use diary::Diary;
pub use diary::{Cause, Trouble};
use proto::ActionMode;
use proto::metrics::EvalReport;
use proto::unit::End;

/// All that an evaluation of the expert needs besides blueprints.
#[derive(Clone, Debug)]
pub struct ExpertSetup<'c> {
    /// Where blueprints come from.
    pub catalog: &'c Catalog,
    /// The world.
    pub environment: EnvironmentConfig,
    /// Episodes per blueprint.
    pub n_episodes: u32,
    /// How they begin.
    pub starts: Starts,
    /// Reset-free runs as well, when given.
    pub reset_free: Option<ResetFreeConfig>,
    /// Threads, at least 1.
    pub n_threads: usize,
    /// Seed of the start states, the same as those of a policy's evaluation with this seed.
    pub seed: u64,
    /// Keep a replay of the first success of each blueprint.
    pub keeps_successes: bool,
}

/// How the expert did.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExpertReport {
    /// The paper's groups in its order, those of which no blueprint was judged left out, then all.
    pub groups: Vec<ExpertGroup>,
    /// Each blueprint, ordered by split, size and id.
    pub blueprints: Vec<ExpertBlueprint>,
    /// Goals in a row without a reset; `null` when that was not asked for.
    pub reset_free: Option<ExpertResetFree>,
    /// Environment steps of all episodes.
    pub n_steps: u64,
    /// Episodes that failed, in the order of the blueprints.
    pub failures: Vec<ExpertFailure>,
    /// The first success of each blueprint that was built, step by step, if the setup asks for it; not part of the
    /// report's JSON.
    #[serde(skip)]
    pub successes: Vec<Trajectory>,
}

/// Blueprints that are reported together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExpertGroup {
    /// Name of the group.
    pub name: String,
    /// Blueprints in it.
    pub n_blueprints: u64,
    /// Blueprints of it that were built at least once.
    pub n_built: u64,
    /// Success, steps and return.
    pub outcome: EvalOutcome,
}

/// One blueprint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExpertBlueprint {
    /// Which.
    pub blueprint: BlueprintId,
    /// Its split.
    pub split: Split,
    /// Its number of blocks.
    pub n_blocks: u64,
    /// Success, steps and return.
    pub outcome: EvalOutcome,
}

/// Reset-free runs (paper, "Reset-Free Evaluation").
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExpertResetFree {
    /// Number of runs.
    pub n_runs: u64,
    /// Goals of a run.
    pub n_goals: u64,
    /// What they gave.
    pub runs: EvalRuns,
}

/// An episode that failed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExpertFailure {
    /// The goal.
    pub blueprint: BlueprintId,
    /// Number of the episode, from 0.
    pub episode_idx: u64,
    /// What went wrong.
    #[serde(flatten)]
    pub trouble: Trouble,
    /// Every step, for a replay; not part of the report's JSON. `None` if the episode has no step to show.
    #[serde(skip)]
    pub replay: Option<Trajectory>,
}

/// One episode of the expert.
struct Trial {
    results: EpisodeResult,
    failure: Option<ExpertFailure>,
    success: Option<Trajectory>,
}

/// Judges the expert on `blueprints`, then on reset-free runs if the setup has any. `keep_going` is asked at every step.
///
/// # Errors
/// When the world cannot be made, an episode cannot be started, or `keep_going` says no.
pub fn evaluate_expert(
    setup: &ExpertSetup<'_>,
    blueprints: &[&Blueprint],
    keep_going: &(dyn Fn() -> bool + Sync),
) -> Result<ExpertReport, EvalError> {
    let sequence = |blueprint: &Blueprint| -> Vec<EpisodeSpec> {
        let spec = |idx| EpisodeSpec::one_of(setup.catalog, blueprint, setup.starts, setup.seed, idx);
        (0..u64::from(setup.n_episodes)).map(spec).collect()
    };
    let sequences: Vec<Vec<EpisodeSpec>> = blueprints.iter().map(|blueprint| sequence(blueprint)).collect();
    let trials = run_all(setup, &sequences, setup.keeps_successes, keep_going)?;
    let (mut failures, mut successes) = (Vec::new(), Vec::new());
    let mut episodes = Vec::new();
    for trial in trials.into_iter().flatten() {
        failures.extend(trial.failure);
        successes.extend(trial.success);
        episodes.push(trial.results.episode);
    }
    let n_steps = episodes.iter().map(|episode| u64::from(episode.n_steps)).sum();
    let judged = Judged {
        weights_version: proto::WeightsVersion(0),
        n_env_steps: 0,
        seed: setup.seed,
        n_planned: episodes.len() as u64,
        is_complete: true,
    };
    let EvalReport { summary, blueprints } = summarize(judged, &episodes);
    let blueprints: Vec<ExpertBlueprint> = blueprints
        .into_iter()
        .map(|b| ExpertBlueprint { blueprint: b.blueprint, split: b.split, n_blocks: b.n_blocks, outcome: b.mode })
        .collect();
    let n_built = |name: &str| {
        let built = |b: &&ExpertBlueprint| b.outcome.success.n_successes > 0;
        let group =
            |b: &ExpertBlueprint| blueprints::Group::of(b.split, b.n_blocks as usize).map(blueprints::Group::name);
        let of_group = |b: &&ExpertBlueprint| name == summary.all.name || group(b) == Some(name);
        blueprints.iter().filter(of_group).filter(built).count() as u64
    };
    let all = summary.groups.iter().chain([&summary.all]);
    let groups = all.map(|g| ExpertGroup {
        name: g.name.clone(),
        n_blueprints: g.n_blueprints,
        n_built: n_built(&g.name),
        outcome: g.mode,
    });
    let groups = groups.collect();
    let reset_free = setup.reset_free.as_ref().map(|config| run_reset_free(setup, config, keep_going)).transpose()?;
    Ok(ExpertReport { groups, blueprints, reset_free, n_steps, failures, successes })
}

fn run_reset_free(
    setup: &ExpertSetup<'_>,
    config: &ResetFreeConfig,
    keep_going: &(dyn Fn() -> bool + Sync),
) -> Result<ExpertResetFree, EvalError> {
    let sequences = reset_free::sequences(setup.catalog, config, setup.seed)?;
    let trials = run_all(setup, &sequences, false, keep_going)?;
    let runs: Vec<Vec<EpisodeResult>> =
        trials.into_iter().map(|run| run.into_iter().map(|trial| trial.results).collect()).collect();
    let score: EvalResetFree = reset_free::score(config, &runs, ActionMode::Greedy);
    Ok(ExpertResetFree { n_runs: score.n_runs, n_goals: score.n_goals, runs: score.mode })
}

fn run_all(
    setup: &ExpertSetup<'_>,
    sequences: &[Vec<EpisodeSpec>],
    keeps_successes: bool,
    keep_going: &(dyn Fn() -> bool + Sync),
) -> Result<Vec<Vec<Trial>>, EvalError> {
    let success = &setup.environment.success;
    let rules = Rules { catalog: setup.catalog, acting: ActionMode::Greedy, success, keep_going, films: None };
    share_out(sequences, setup.n_threads, |sequences| {
        let mut world = World::new(&setup.environment)?;
        let mut results = Vec::with_capacity(sequences.len());
        for (sequence_idx, sequence) in sequences.iter().enumerate().filter(|(_, sequence)| !sequence.is_empty()) {
            let (mut slot, _) = EnvSlot::begin(&rules, world, sequence_idx, sequence.as_slice().into())?;
            let mut trials: Vec<Trial> = Vec::with_capacity(sequence.len());
            for (job_idx, spec) in sequence.iter().enumerate() {
                if job_idx > 0 {
                    slot.start(&rules, job_idx)?;
                }
                let mut trial = run_episode(&rules, &setup.environment, &mut slot, spec, job_idx as u64)?;
                // One is enough to look at, and all of them would be gigabytes.
                if !keeps_successes || trials.iter().any(|earlier| earlier.success.is_some()) {
                    trial.success = None;
                }
                trials.push(trial);
            }
            results.push(trials);
            world = slot.env;
        }
        Ok(results)
    })
}

/// Shares the sequences out among threads; the results are in the order of the sequences.
fn share_out<T: Send>(
    sequences: &[Vec<EpisodeSpec>],
    n_threads: usize,
    run: impl Fn(&[Vec<EpisodeSpec>]) -> Result<Vec<T>, EvalError> + Sync,
) -> Result<Vec<T>, EvalError> {
    if n_threads <= 1 {
        return run(sequences);
    }
    // Dealt out in turn, because neighbors cost alike.
    let n_shares = n_threads.min(sequences.len()).max(1);
    let shares: Vec<Vec<Vec<EpisodeSpec>>> =
        (0..n_shares).map(|first| sequences.iter().skip(first).step_by(n_shares).cloned().collect()).collect();
    std::thread::scope(|scope| {
        let run = &run;
        let threads: Vec<_> = shares.iter().map(|sequences| scope.spawn(move || run(sequences))).collect();
        let mut piles = Vec::with_capacity(n_shares);
        for thread in threads {
            piles.push(thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?.into_iter());
        }
        Ok((0..sequences.len()).filter_map(|sequence_idx| piles[sequence_idx % n_shares].next()).collect())
    })
}

fn run_episode(
    rules: &Rules<'_>,
    config: &EnvironmentConfig,
    slot: &mut EnvSlot<World>,
    spec: &EpisodeSpec,
    episode_idx: u64,
) -> Result<Trial, EvalError> {
    let mut expert = Expert::new(config, slot.env.blueprint());
    let mut diary = Diary::new(slot.env.scene(), slot.env.blueprint());
    loop {
        if !(rules.keep_going)() {
            return Err(EvalError::Interrupted);
        }
        let scene = slot.env.scene().clone();
        let decision = match &mut expert {
            Ok(expert) => expert.decide(&scene),
            // It does nothing until the time is up, as an episode must end.
            Err(_) => diary::nothing(),
        };
        let results = slot.step(rules, &decision.action);
        let after = slot.end_scene.as_ref().unwrap_or_else(|| slot.env.scene());
        diary.note(scene, decision, slot.reward, after, slot.env.blueprint());
        let Some(results) = results else { continue };
        let status = match results.episode.end {
            End::Success { .. } => Status::Success,
            End::TimeLimit => Status::TimeLimit,
            End::Diverged => Status::Diverged,
        };
        let trouble = diary.trouble(status, expert.is_err());
        let replay = diary.into_replay(spec.task(), after, &results.episode);
        if status == Status::Success {
            return Ok(Trial { results, failure: None, success: replay });
        }
        let failure = ExpertFailure { blueprint: spec.task().blueprint.clone(), episode_idx, trouble, replay };
        return Ok(Trial { results, failure: Some(failure), success: None });
    }
}

#[cfg(test)]
mod tests;

//! Evaluates the scripted expert like a policy, and explains its failures.

mod diary;

use blueprints::{Blueprint, BlueprintId, Group, Split};
use environment::ExpertAgent;
use parking_lot::Mutex;
use proto::metrics::{EvalOutcome, EvalReport, EvalRuns};
use proto::{ActionMode, Trajectory, WeightsVersion};
use serde::{Deserialize, Serialize};

use crate::follower::{Both, Follower};
use crate::pool::EvaluationPool;
use crate::report::{EpisodeResult, summarize};
use crate::reset_free;
use crate::sequences::EpisodeSpec;
use crate::setup::{EvalError, EvalSetup};
use diary::Diaries;
pub use diary::{Cause, ExpertFailure, Trouble};

/// Results of the expert.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExpertReport {
    /// Whether all episodes and runs are complete.
    #[serde(default = "complete")]
    pub is_complete: bool,
    /// The paper's groups in its order, without groups in which no blueprint was evaluated, followed by all blueprints.
    pub groups: Vec<ExpertGroup>,
    /// Each blueprint, ordered by split, size and id.
    pub blueprints: Vec<ExpertBlueprint>,
    /// Several goals in a row without a reset; `null` if not requested.
    pub reset_free: Option<ExpertResetFree>,
    /// Environment steps of all episodes.
    pub n_steps: u64,
    /// Failed episodes, in the order of the blueprints.
    pub failures: Vec<ExpertFailure>,
    /// The first success of each blueprint that was built, step by step; not part of the report's JSON.
    #[serde(skip)]
    pub successes: Vec<Trajectory>,
}

/// Default of `is_complete`: earlier versions wrote only complete reports.
fn complete() -> bool {
    true
}

/// Results of a group of blueprints.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExpertGroup {
    /// Name of the group.
    pub name: String,
    /// Number of blueprints in the group.
    pub n_blueprints: u64,
    /// Number of blueprints in the group that were built at least once.
    pub n_built: u64,
    /// Success, steps and return.
    pub outcome: EvalOutcome,
}

/// Results for one blueprint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExpertBlueprint {
    /// The blueprint.
    pub blueprint: BlueprintId,
    /// Its split.
    pub split: Split,
    /// Its number of blocks.
    pub n_blocks: u64,
    /// Success, steps and return.
    pub outcome: EvalOutcome,
}

/// Results of reset-free runs (paper, "Reset-Free Evaluation").
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExpertResetFree {
    /// Number of runs.
    pub n_runs: u64,
    /// Goals per run.
    pub n_goals: u64,
    /// Results of the runs.
    pub runs: EvalRuns,
}

/// Evaluates the expert on `blueprints`, followed by reset-free runs if the setup has any, and calls `follower` for each
/// episode. Start states are those of a policy's evaluation with the same seed. The setup's action modes are ignored.
/// Returns an incomplete report when `keep_going` returns false.
///
/// # Errors
/// If the world cannot be created or an episode cannot be started.
pub fn evaluate_expert_followed(
    setup: &EvalSetup<'_>,
    blueprints: &[&Blueprint],
    follower: &Follower<'_>,
) -> Result<ExpertReport, EvalError> {
    let sequence = |blueprint: &Blueprint| -> Vec<EpisodeSpec> {
        let spec = |idx| EpisodeSpec::one_of(setup.catalog, blueprint, setup.episodes.starts, setup.seed, idx);
        (0..u64::from(setup.episodes.n_episodes)).map(spec).collect()
    };
    let sequences: Vec<Vec<EpisodeSpec>> = blueprints.iter().map(|blueprint| sequence(blueprint)).collect();
    let diaries = Diaries::default();
    let ended_episodes = Mutex::new(Vec::new());
    let on_episode = |episode: &EpisodeResult| {
        ended_episodes.lock().push(episode.clone());
        (follower.on_episode)(episode);
    };
    let counting = Follower { on_episode: &on_episode, keep_going: follower.keep_going };
    let agent = || Ok::<_, EvalError>(ExpertAgent::new(&setup.environment));
    let observer = Some(&Both(&diaries, &counting));
    let pool = EvaluationPool { setup, agent: &agent, observer, progress: None, keep_going: follower.keep_going };
    let runs = |config| reset_free::evaluate(&pool, config, &[ActionMode::Greedy]);
    let (episodes, ended) = pool.run(&sequences, ActionMode::Greedy);
    let played = ended.and_then(|()| {
        let reset_free = setup.reset_free.as_ref().map(runs).transpose()?;
        Ok((episodes.into_iter().flatten().collect::<Vec<EpisodeResult>>(), reset_free))
    });
    let (episodes, reset_free, is_complete) = match played {
        Ok((episodes, reset_free)) => (episodes, reset_free, true),
        Err(EvalError::Interrupted) => (ended_episodes.into_inner(), None, false),
        Err(error) => return Err(error),
    };
    let reset_free = reset_free.map(|r| ExpertResetFree { n_runs: r.n_runs, n_goals: r.n_goals, runs: r.greedy });
    Ok(report(&episodes, reset_free, diaries, is_complete))
}

/// Builds the report from the episodes.
fn report(
    episodes: &[EpisodeResult],
    reset_free: Option<ExpertResetFree>,
    diaries: Diaries,
    is_complete: bool,
) -> ExpertReport {
    let n_steps = episodes.iter().map(|episode| u64::from(episode.n_steps)).sum();
    let EvalReport { summary, blueprints } = summarize(WeightsVersion(0), 0, episodes);
    let blueprints: Vec<ExpertBlueprint> = blueprints
        .into_iter()
        .map(|b| ExpertBlueprint { blueprint: b.blueprint, split: b.split, n_blocks: b.n_blocks, outcome: b.greedy })
        .collect();
    let n_built = |name: &str| {
        let built = |b: &&ExpertBlueprint| b.outcome.success.n_successes > 0;
        let group = |b: &ExpertBlueprint| Group::of(b.split, b.n_blocks as usize).map(Group::name);
        let of_group = |b: &&ExpertBlueprint| name == summary.all.name || group(b) == Some(name);
        blueprints.iter().filter(of_group).filter(built).count() as u64
    };
    let all = summary.groups.iter().chain([&summary.all]);
    let groups = all.map(|g| ExpertGroup {
        name: g.name.clone(),
        n_blueprints: g.n_blueprints,
        n_built: n_built(&g.name),
        outcome: g.greedy,
    });
    let groups = groups.collect();
    let (failures, successes) = diaries.into_replays();
    ExpertReport { is_complete, groups, blueprints, reset_free, n_steps, failures, successes }
}

#[cfg(test)]
mod tests;

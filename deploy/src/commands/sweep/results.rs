//! How the runs of a sweep ended, and their success.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Context;
use blueprints::{Group, outside};
use proto::ActionMode;
use runlog::series::{group_of, lineage, outcome_of};
use runlog::{History, Pass, RunPaths};
use serde::{Deserialize, Serialize};

use super::curves::{self, Moment};
use super::plan::{Plan, Run};
use super::statistics::Aggregate;
use crate::commands::names::name;
use crate::exit::Failure;
use crate::replace::{PLAIN, replace};

/// Maximum size of a result in bytes; one of the whole catalog has about 50 000.
const MAX_BYTES: u64 = 16 << 20;

/// Name of the runs of several goals without a reset, as in `report`.
const RESET_FREE: &str = "reset-free";

/// How a run ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "state", rename_all = "kebab-case")]
pub(super) enum RunResult {
    /// It has all of its steps, and its last weights are evaluated.
    Done {
        /// Environment steps of the evaluated weights.
        n_env_steps: u64,
        /// Success on each goal.
        scores: Vec<Score>,
    },
    /// It ended early.
    Failed {
        /// Its exit status.
        status: String,
    },
}

/// Success of a run on one goal.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Score {
    pub(super) group: String,
    pub(super) goal: String,
    pub(super) acting: ActionMode,
    pub(super) rate: f64,
}

/// The success of a point in a group.
#[derive(Debug, PartialEq, Serialize)]
pub(super) struct GroupResult {
    pub(super) group: String,
    pub(super) acting: ActionMode,
    pub(super) n_runs: usize,
    pub(super) n_goals: usize,
    #[serde(flatten)]
    pub(super) aggregate: Aggregate,
}

/// A point of the table.
#[derive(Debug, Serialize)]
pub(super) struct PointResult {
    pub(super) name: String,
    settings: Vec<(String, String)>,
    /// After all steps.
    pub(super) groups: Vec<GroupResult>,
    /// Over the steps; empty unless asked for.
    pub(super) curve: Vec<Moment>,
    n_done: usize,
    pub(super) failed: Vec<FailedRun>,
    pub(super) unfinished: Vec<u64>,
}

/// A run that failed.
#[derive(Debug, Serialize)]
pub(super) struct FailedRun {
    pub(super) seed: u64,
    pub(super) status: String,
    #[serde(serialize_with = "outside::as_text")]
    pub(super) log: PathBuf,
}

/// The results of a sweep.
#[derive(Debug, Serialize)]
pub(in crate::commands) struct Results {
    #[serde(serialize_with = "outside::as_text")]
    folder: PathBuf,
    seeds: Vec<u64>,
    pub(super) points: Vec<PointResult>,
    /// The runs that are done, seed by seed.
    done: Vec<Run>,
}

impl RunResult {
    /// Reads how a run ended; `None` if it has not.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub(super) fn read(run: &Run) -> Result<Option<Self>, Failure> {
        let path = run.result();
        if !path.exists() {
            return Ok(None);
        }
        let read = || Ok(serde_json::from_slice(&outside::read(&path, MAX_BYTES)?)?);
        let failed = |error: anyhow::Error| Failure::Checkpoint(error.context(format!("reading {}", path.display())));
        read().map(Some).map_err(failed)
    }

    /// Writes how a run ended.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub(super) fn keep(&self, run: &Run) -> anyhow::Result<()> {
        let path = run.result();
        replace(&path, &serde_json::to_vec_pretty(self)?, PLAIN).with_context(|| format!("writing {}", path.display()))
    }

    /// The scores of a run's last evaluation; `None` if it does not have all of its steps, or they are not evaluated.
    ///
    /// # Errors
    /// When its history cannot be read.
    pub(super) fn of_run(folder: &Path, n_env_steps: u64) -> anyhow::Result<Option<Self>> {
        let history = RunPaths::new(folder).history();
        let passes = if history.exists() { History::read(&history)? } else { Vec::new() };
        let last = lineage(&passes).pop().filter(|last| last.n_env_steps >= n_env_steps);
        Ok(last.map(|last| Self::Done { n_env_steps: last.n_env_steps, scores: scores(last) }))
    }
}

/// The success of an evaluation on every goal.
pub(super) fn scores(pass: &Pass) -> Vec<Score> {
    let mut scores = Vec::new();
    for acting in [ActionMode::Greedy, ActionMode::Sampled] {
        for score in &pass.blueprints {
            if let (Some(group), Some(outcome)) = (group_of(score), outcome_of(score, acting)) {
                let (group, goal) = (group.name().to_owned(), score.blueprint.to_string());
                scores.push(Score { group, goal, acting, rate: outcome.success.rate });
            }
        }
    }
    let runs = pass
        .reset_free
        .iter()
        .flat_map(|runs| [(ActionMode::Greedy, &runs.greedy), (ActionMode::Sampled, &runs.sampled)]);
    for (acting, runs) in runs.filter(|(_, runs)| runs.outcome.success.n_episodes > 0) {
        let rate = runs.outcome.success.rate;
        scores.push(Score { group: RESET_FREE.to_owned(), goal: RESET_FREE.to_owned(), acting, rate });
    }
    scores
}

/// The aggregates of several runs, first those of greedy actions, the groups in their order.
pub(super) fn groups(runs: &[&[Score]]) -> Vec<GroupResult> {
    let mut rates: BTreeMap<(ActionMode, usize, &str), BTreeMap<&str, Vec<f64>>> = BTreeMap::new();
    for Score { group, goal, acting, rate } in runs.iter().copied().flatten() {
        let place = Group::ALL.iter().position(|known| known.name() == group).unwrap_or(Group::ALL.len());
        rates.entry((*acting, place, group)).or_default().entry(goal).or_default().push(*rate);
    }
    let of_group = |((acting, _, group), goals): ((_, _, &str), BTreeMap<&str, Vec<f64>>)| {
        let scores: Vec<Vec<f64>> = goals.into_values().collect();
        let n_runs = scores.iter().map(Vec::len).max().unwrap_or(0);
        let (group, n_goals, aggregate) = (group.to_owned(), scores.len(), Aggregate::of(&scores));
        GroupResult { group, acting, n_runs, n_goals, aggregate }
    };
    rates.into_iter().map(of_group).collect()
}

impl Results {
    /// Collects the results of all runs, without curves.
    ///
    /// # Errors
    /// When a result cannot be read.
    pub(super) fn of(plan: &Plan, folder: &Path) -> Result<Self, Failure> {
        let results = plan.runs(folder).into_iter().map(|run| Ok((RunResult::read(&run)?, run)));
        let results: Vec<(Option<RunResult>, Run)> = results.collect::<Result<_, Failure>>()?;
        let point = |(i, planned): (usize, &super::plan::PlannedPoint)| {
            let (mut done, mut failed, mut unfinished) = (Vec::new(), Vec::new(), Vec::new());
            for (result, run) in results.iter().filter(|(_, run)| run.point == i) {
                match result {
                    Some(RunResult::Done { scores, .. }) => done.push(scores.as_slice()),
                    Some(RunResult::Failed { status }) => {
                        failed.push(FailedRun { seed: run.seed, status: status.clone(), log: run.log() });
                    }
                    None => unfinished.push(run.seed),
                }
            }
            let (name, settings, n_done) = (planned.name(), planned.settings.clone(), done.len());
            PointResult { name, settings, groups: groups(&done), curve: Vec::new(), n_done, failed, unfinished }
        };
        let points = plan.points.iter().enumerate().map(point).collect();
        let is_done =
            |(result, run): (Option<RunResult>, Run)| matches!(result, Some(RunResult::Done { .. })).then_some(run);
        let done = results.into_iter().filter_map(is_done).collect();
        Ok(Self { folder: folder.to_owned(), seeds: plan.seeds.clone(), points, done })
    }

    /// Adds the curves of the runs that are done.
    ///
    /// # Errors
    /// When the history of one cannot be read.
    pub(super) fn with_curves(mut self) -> Result<Self, Failure> {
        for (i, point) in self.points.iter_mut().enumerate() {
            point.curve = curves::of(self.done.iter().filter(|run| run.point == i))?;
        }
        Ok(self)
    }

    /// Folder and name of the first `n` runs that are done.
    ///
    /// # Errors
    /// When there is none.
    pub(in crate::commands) fn done(&self, n: usize) -> Result<(Vec<PathBuf>, Vec<String>), Failure> {
        let named = |run: &Run| (run.folder.clone(), format!("{}, seed {}", self.points[run.point].name, run.seed));
        if self.done.is_empty() {
            let folder = self.folder.display();
            return Err(Failure::NothingToShow(format!("no run of {folder} is done yet: wait for the first one")));
        }
        Ok(self.done.iter().take(n).map(named).unzip())
    }

    /// The same without the paths of this machine, for a page that others can see.
    pub(in crate::commands) fn without_paths(mut self) -> Self {
        for failed in self.points.iter_mut().flat_map(|point| &mut point.failed) {
            failed.log = failed.log.strip_prefix(&self.folder).map(Path::to_owned).unwrap_or_default();
        }
        self.folder = name(&self.folder).into();
        self
    }

    /// Whether anything was evaluated with this action mode.
    pub(in crate::commands) fn has(&self, acting: ActionMode) -> bool {
        self.points.iter().flat_map(|point| &point.groups).any(|group| group.acting == acting)
    }

    /// Number of runs that failed, and of those that have not ended.
    pub(super) fn n_missing(&self) -> (usize, usize) {
        let count = |n: fn(&PointResult) -> usize| self.points.iter().map(n).sum();
        (count(|point| point.failed.len()), count(|point| point.unfinished.len()))
    }
}

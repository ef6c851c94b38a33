//! How the runs of a sweep ended, and their success.

use std::path::{Path, PathBuf};

use blueprints::outside;
use proto::ActionMode;
use runlog::{History, RunPaths};
use serde::{Deserialize, Serialize};

use super::plan::{Plan, Run};
use super::scores::{GroupResult, Moment, Score, curve, groups, scores};
use crate::commands::files::{read_json, write_file};
use crate::commands::names::name;
use crate::exit::Failure;

/// How a run ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "state", rename_all = "kebab-case")]
pub(super) enum RunResult {
    /// It has all of its steps, and its last weights are evaluated.
    Done {
        /// Environment steps of the evaluated weights.
        n_env_steps: u64,
        scores: Vec<Score>,
    },
    /// It ended early.
    Failed { status: String },
}

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

#[derive(Debug, Serialize)]
pub(super) struct FailedRun {
    pub(super) seed: u64,
    pub(super) status: String,
    #[serde(serialize_with = "outside::as_text")]
    pub(super) log: PathBuf,
}

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
    pub(super) fn read(run: &Run) -> Result<Option<Self>, Failure> {
        let path = run.result();
        if !path.exists() {
            return Ok(None);
        }
        read_json(&path).map(Some)
    }

    /// Writes how a run ended.
    pub(super) fn keep(&self, run: &Run) -> anyhow::Result<()> {
        write_file(&run.result(), &serde_json::to_vec_pretty(self)?)
    }

    /// The scores of a run's last evaluation; `None` if it does not have all of its steps, or they are not evaluated.
    pub(super) fn of_run(folder: &Path, n_env_steps: u64) -> anyhow::Result<Option<Self>> {
        let history = RunPaths::new(folder).history();
        let mut evaluations = if history.exists() { History::read(&history)? } else { Vec::new() };
        let last = evaluations.pop().filter(|last| last.n_env_steps >= n_env_steps);
        Ok(last.map(|last| Self::Done { n_env_steps: last.n_env_steps, scores: scores(&last) }))
    }
}

impl Results {
    /// Collects the results of all runs, without curves.
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
    pub(super) fn with_curves(mut self) -> Result<Self, Failure> {
        for (i, point) in self.points.iter_mut().enumerate() {
            point.curve = curve(self.done.iter().filter(|run| run.point == i))?;
        }
        Ok(self)
    }

    /// Folder and name of the first `n` runs that are done.
    pub(in crate::commands) fn done(&self, n: usize) -> Result<(Vec<PathBuf>, Vec<String>), Failure> {
        let named = |run: &Run| (run.folder.clone(), format!("{}, seed {}", self.points[run.point].name, run.seed));
        if self.done.is_empty() {
            let folder = self.folder.display();
            return Err(Failure::NothingToShow(format!(
                "no run of {folder} is done yet: wait for the first one, or start the sweep again"
            )));
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

//! How the runs of a sweep ended, and the table of their success.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;
use blueprints::outside;
use proto::ActionMode;
use runlog::series::{group_of, lineage, outcome_of};
use runlog::{History, Pass, RunPaths};
use serde::{Deserialize, Serialize};

use super::plan::{Plan, Run};
use super::statistics::Aggregate;
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
    group: String,
    goal: String,
    acting: ActionMode,
    rate: f64,
}

/// The success of a point in a group.
#[derive(Debug, PartialEq, Serialize)]
struct GroupResult {
    group: String,
    acting: ActionMode,
    n_runs: usize,
    n_goals: usize,
    #[serde(flatten)]
    aggregate: Aggregate,
}

/// A point of the table.
#[derive(Debug, Serialize)]
struct PointResult {
    name: String,
    settings: Vec<(String, String)>,
    groups: Vec<GroupResult>,
    n_done: usize,
    failed: Vec<FailedRun>,
    unfinished: Vec<u64>,
}

/// A run that failed.
#[derive(Debug, Serialize)]
struct FailedRun {
    seed: u64,
    status: String,
    #[serde(serialize_with = "outside::as_text")]
    log: PathBuf,
}

/// The results of a sweep.
#[derive(Debug, Serialize)]
pub(super) struct Table {
    #[serde(serialize_with = "outside::as_text")]
    folder: PathBuf,
    seeds: Vec<u64>,
    points: Vec<PointResult>,
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

fn scores(pass: &Pass) -> Vec<Score> {
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

/// The aggregates of several runs, in the order of the groups in the first one.
fn groups(runs: &[&[Score]]) -> Vec<GroupResult> {
    let mut order: Vec<(&str, ActionMode)> = Vec::new();
    let mut rates: BTreeMap<(usize, &str), Vec<f64>> = BTreeMap::new();
    for score in runs.iter().copied().flatten() {
        let group = (score.group.as_str(), score.acting);
        let at = order.iter().position(|known| *known == group).unwrap_or(order.len());
        if at == order.len() {
            order.push(group);
        }
        rates.entry((at, &score.goal)).or_default().push(score.rate);
    }
    let of_group = |(at, &(group, acting)): (usize, &(&str, ActionMode))| {
        let scores: Vec<Vec<f64>> =
            rates.iter().filter(|((i, _), _)| *i == at).map(|(_, rates)| rates.clone()).collect();
        let n_runs = scores.iter().map(Vec::len).max().unwrap_or(0);
        let (group, n_goals, aggregate) = (group.to_owned(), scores.len(), Aggregate::of(&scores));
        GroupResult { group, acting, n_runs, n_goals, aggregate }
    };
    order.iter().enumerate().map(of_group).collect()
}

impl Table {
    /// Collects the results of all runs.
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
            let (name, settings) = (planned.name(), planned.settings.clone());
            PointResult { name, settings, groups: groups(&done), n_done: done.len(), failed, unfinished }
        };
        let points = plan.points.iter().enumerate().map(point).collect();
        Ok(Self { folder: folder.to_owned(), seeds: plan.seeds.clone(), points })
    }

    /// Number of runs that failed, and of those that have not ended.
    pub(super) fn n_missing(&self) -> (usize, usize) {
        let count = |n: fn(&PointResult) -> usize| self.points.iter().map(n).sum();
        (count(|point| point.failed.len()), count(|point| point.unfinished.len()))
    }

    /// Renders a Markdown table with rates in percent, and below it the runs that are missing in it.
    pub(super) fn render(&self) -> String {
        let mut text = "| point | group (goals) | actions | seeds | mean, % | IQM, % | 95 % of the IQM |\n\
                        |---|---|---|---|---|---|---|\n"
            .to_owned();
        let mut missing = String::new();
        for PointResult { name, groups, failed, unfinished, .. } in &self.points {
            for GroupResult { group, acting, n_runs, n_goals, aggregate } in groups {
                let [mean, iqm] = [aggregate.mean, aggregate.iqm].map(|rate| format!("{:.1}", 100.0 * rate));
                let range = |[low, high]: [f64; 2]| format!("{:.1}–{:.1}", 100.0 * low, 100.0 * high);
                let interval = aggregate.iqm_interval.map_or_else(|| "-".to_owned(), range);
                line(
                    &mut text,
                    format_args!(
                        "| {name} | {group} ({n_goals}) | {acting} | {n_runs} | {mean} | {iqm} | {interval} |"
                    ),
                );
            }
            if groups.is_empty() {
                let state = if failed.is_empty() { "not finished" } else { "failed" };
                line(&mut text, format_args!("| {name} | {state} | | 0 | | | |"));
            }
            for FailedRun { seed, status, log } in failed {
                line(&mut missing, format_args!("failed: {name}, seed {seed} ({status}); see {}", log.display()));
            }
            if !unfinished.is_empty() {
                line(&mut missing, format_args!("not finished: {name}, seeds {unfinished:?}"));
            }
        }
        if missing.is_empty() { text } else { format!("{text}\n{missing}") }
    }
}

fn line(text: &mut String, line: std::fmt::Arguments<'_>) {
    writeln!(text, "{line}").expect("a string takes all");
}

#[cfg(test)]
mod tests {
    use super::super::plan::PlannedPoint;
    use super::*;

    fn score(goal: &str, rate: f64) -> Score {
        Score { group: "train 2-6".to_owned(), goal: goal.to_owned(), acting: ActionMode::Sampled, rate }
    }

    #[test]
    fn the_table_has_every_point_and_says_what_is_missing() {
        let folder = tempfile::tempdir().unwrap();
        let point = |gamma: &str| PlannedPoint {
            settings: vec![("learner.gamma".to_owned(), gamma.to_owned())],
            config: String::new(),
        };
        let plan = Plan {
            lodestone_version: String::new(),
            command: Vec::new(),
            seeds: vec![1, 2],
            points: ["0.9", "0.95", "0.99"].map(point).to_vec(),
        };
        let keep = |point: usize, seed: u64, result: RunResult| {
            let runs = plan.runs(folder.path());
            let run = runs.iter().find(|run| (run.point, run.seed) == (point, seed)).unwrap();
            std::fs::create_dir_all(run.folder.parent().unwrap()).unwrap();
            result.keep(run).unwrap();
            assert_eq!(RunResult::read(run).unwrap(), Some(result));
        };
        let done = |rates: [f64; 2]| RunResult::Done {
            n_env_steps: 9,
            scores: vec![score("2_000", rates[0]), score("2_001", rates[1])],
        };
        keep(0, 1, done([0.5, 1.0]));
        keep(0, 2, done([0.5, 1.0]));
        keep(1, 1, done([0.25, 0.25]));
        keep(2, 1, RunResult::Failed { status: "exit status: 64".to_owned() });
        let table = Table::of(&plan, folder.path()).unwrap();
        let log = folder.path().join("point-3/seed-1.log");
        let expected = format!(
            "| point | group (goals) | actions | seeds | mean, % | IQM, % | 95 % of the IQM |\n\
             |---|---|---|---|---|---|---|\n\
             | learner.gamma=0.9 | train 2-6 (2) | sampled | 2 | 75.0 | 75.0 | 75.0–75.0 |\n\
             | learner.gamma=0.95 | train 2-6 (2) | sampled | 1 | 25.0 | 25.0 | - |\n\
             | learner.gamma=0.99 | failed | | 0 | | | |\n\
             \n\
             not finished: learner.gamma=0.95, seeds [2]\n\
             failed: learner.gamma=0.99, seed 1 (exit status: 64); see {}\n\
             not finished: learner.gamma=0.99, seeds [2]\n",
            log.display()
        );
        assert_eq!((table.render(), table.n_missing()), (expected, (1, 2)));
        let json = serde_json::to_value(&table).unwrap();
        assert_eq!(json["points"][0]["groups"][0]["iqm_interval"], serde_json::json!([0.75, 0.75]));
        assert_eq!(json["points"][2]["failed"][0]["seed"], 1);
    }
}

//! Writes a running evaluator's reports to the run's folder.

use std::collections::VecDeque;

use proto::metrics::{EvalOutcome, EvalReport};
use proto::{ActionMode, Role, keys};
use runlog::{History, HistoryError, Lines, MetricsWriter, Pass, RunPaths};

/// The open record files. Writing can fail for a while, because the disk is full or because another program reads the
/// history; neither ends a run.
pub(crate) struct Records {
    metrics: MetricsWriter,
    history: History,
    /// Rows that the history does not have yet, oldest first.
    waiting: VecDeque<Pass>,
}

impl Records {
    /// Opens the record files. Opens the history first, so that a second writer is refused before anything is written.
    pub(crate) fn open(paths: &RunPaths) -> anyhow::Result<Self> {
        let history = History::open(&paths.history())?;
        Ok(Self { metrics: MetricsWriter::open(paths, Role::Evaluator)?, history, waiting: VecDeque::new() })
    }

    /// Writes a report, whose history row is `row`. A failure is logged; the row then waits for the next call.
    pub(crate) fn keep(&mut self, report: &EvalReport, row: Pass) {
        if let Err(error) = self.metrics(report) {
            tracing::warn!(error = format!("{error:#}"), "an evaluation is missing in the run's metrics");
        }
        self.waiting.push_back(row);
        if let Err(error) = self.catch_up() {
            let n_waiting = self.waiting.len();
            tracing::warn!(%error, n_waiting, "evaluations wait to be written to the history");
        }
    }

    /// Writes the rows that wait to the history.
    ///
    /// # Errors
    /// If the history cannot be written; the remaining rows still wait.
    pub(crate) fn catch_up(&mut self) -> Result<(), HistoryError> {
        while let Some(row) = self.waiting.front() {
            self.history.append(row)?;
            self.waiting.pop_front();
        }
        Ok(())
    }

    fn metrics(&mut self, report: &EvalReport) -> anyhow::Result<()> {
        self.metrics.append(&lines(report)?)?;
        self.metrics.scalars(report.summary.n_env_steps, scalars(report))?;
        Ok(())
    }
}

/// Returns a line for the summary and one for each blueprint.
fn lines(report: &EvalReport) -> anyhow::Result<Lines> {
    let mut lines = Lines::default();
    lines.push(keys::METRICS_EVAL_SUMMARY, &report.summary)?;
    for score in &report.blueprints {
        lines.push(&keys::metrics_eval(score.split, &score.blueprint), score)?;
    }
    Ok(lines)
}

/// Returns the TensorBoard scalars: success (0 to 1) and steps to success per group, and success (0 to 1) per
/// blueprint.
fn scalars(report: &EvalReport) -> Vec<(String, f64)> {
    let was_evaluated = |outcome: &EvalOutcome| outcome.success.n_episodes > 0;
    let mut scalars = Vec::new();
    for group in [&report.summary.all].into_iter().chain(&report.summary.groups) {
        for (acting, outcome) in [(ActionMode::Greedy, &group.mode), (ActionMode::Sampled, &group.sampled)] {
            let (acting, group) = (acting.name(), group.name.replace(' ', "-"));
            if was_evaluated(outcome) {
                scalars.push((format!("success-{acting}/{group}"), outcome.success.rate));
            }
            scalars.extend(outcome.mean_steps_to_success.map(|n| (format!("steps-to-success-{acting}/{group}"), n)));
        }
    }
    for score in &report.blueprints {
        for (acting, outcome) in [(ActionMode::Greedy, &score.mode), (ActionMode::Sampled, &score.sampled)] {
            if was_evaluated(outcome) {
                scalars.push((format!("{}-{}/{}", score.split, acting.name(), score.blueprint), outcome.success.rate));
            }
        }
    }
    scalars
}

#[cfg(test)]
mod tests {
    use proto::WeightsVersion;

    use super::*;
    use crate::report::{End, EpisodeResult, summarize};

    #[test]
    fn rows_wait_until_the_history_can_be_written() {
        let dir = tempfile::tempdir().unwrap();
        let paths = RunPaths::new(dir.path());
        let mut records = Records::open(&paths).unwrap();
        let goal = blueprints::Catalog::builtin().get(&"2_000".parse().unwrap()).unwrap();
        let episode = EpisodeResult {
            blueprint: goal.id().clone(),
            split: goal.split(),
            n_blocks: goal.n_blocks(),
            acting: ActionMode::Greedy,
            end: End::Success { stable: true },
            n_steps: 9,
            episode_return: proto::RewardTerms::default(),
            forced_reset: false,
        };
        let keep = |records: &mut Records, version| {
            let report = summarize(WeightsVersion(version), 100 * version, std::slice::from_ref(&episode));
            records.keep(&report, Pass::new(&report, version));
        };
        keep(&mut records, 1);
        // A folder where SQLite needs a file makes it fail, as a full disk would.
        let journal = dir.path().join("eval.db-journal");
        std::fs::create_dir(&journal).unwrap();
        keep(&mut records, 2);
        keep(&mut records, 3);
        assert_eq!(records.waiting.len(), 2);
        assert!(records.catch_up().is_err());
        std::fs::remove_dir(&journal).unwrap();
        records.catch_up().unwrap();
        drop(records);
        let versions = |passes: Vec<Pass>| passes.iter().map(|pass| pass.n_env_steps).collect::<Vec<_>>();
        assert_eq!(versions(History::read(&paths.history()).unwrap()), [100, 200, 300]);
        let metrics = std::fs::read_to_string(paths.metrics()).unwrap();
        assert_eq!(metrics.lines().count(), 6, "a summary and a blueprint for each evaluation");
    }
}

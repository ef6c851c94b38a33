//! Writes a running evaluator's reports to the run's folder.

use std::collections::VecDeque;

use proto::metrics::EvalReport;
use proto::{Role, keys};
use runlog::{Evaluation, History, HistoryError, Lines, MetricsWriter, RunPaths, WriteError};

/// The open record files. Writing can fail for a while, because the disk is full or because another program reads the
/// history; neither ends a run.
pub(crate) struct Records {
    metrics: MetricsWriter,
    history: History,
    /// Reports that the metrics do not have yet, oldest first.
    unwritten: VecDeque<Unwritten>,
    /// Rows that the history does not have yet, oldest first.
    waiting: VecDeque<Evaluation>,
}

/// What the metrics do not have yet of a report.
struct Unwritten {
    n_env_steps: u64,
    lines: Lines,
    scalars: Vec<(String, f64)>,
}

impl Records {
    /// Opens the record files. Opens the history first, so that a second writer is refused before anything is written.
    pub(crate) fn open(paths: &RunPaths) -> anyhow::Result<Self> {
        let history = History::open(&paths.history())?;
        let metrics = MetricsWriter::open(paths, Role::Evaluator)?;
        Ok(Self { metrics, history, unwritten: VecDeque::new(), waiting: VecDeque::new() })
    }

    /// Writes a report, whose history row is `row`. A failure is logged; both then wait for the next call.
    pub(crate) fn keep(&mut self, report: &EvalReport, row: Evaluation) {
        match lines(report) {
            Ok(lines) => {
                let n_env_steps = report.summary.n_env_steps;
                let scalars = scalars(report);
                self.unwritten.push_back(Unwritten { n_env_steps, lines, scalars });
            }
            Err(error) => tracing::warn!(error = format!("{error:#}"), "an evaluation is missing in the run's metrics"),
        }
        self.waiting.push_back(row);
        if let Err(error) = self.catch_up() {
            let n_waiting = self.waiting.len();
            tracing::warn!(%error, n_waiting, "evaluations wait to be written to the history");
        }
    }

    fn catch_up_metrics(&mut self) -> Result<(), WriteError> {
        while let Some(Unwritten { n_env_steps, lines, scalars }) = self.unwritten.front_mut() {
            self.metrics.append(lines)?;
            // Not again, if the curves fail.
            *lines = Lines::default();
            self.metrics.scalars(*n_env_steps, scalars.iter().cloned())?;
            self.unwritten.pop_front();
        }
        Ok(())
    }

    /// Writes the reports that wait to the metrics, and the rows to the history.
    ///
    /// # Errors
    /// If the history cannot be written; the remaining rows still wait.
    pub(crate) fn catch_up(&mut self) -> Result<(), HistoryError> {
        if let Err(error) = self.catch_up_metrics() {
            let n_waiting = self.unwritten.len();
            tracing::warn!(%error, n_waiting, "evaluations wait to be written to the run's metrics");
        }
        while let Some(row) = self.waiting.front() {
            self.history.append(row)?;
            self.waiting.pop_front();
        }
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
    let mut scalars = Vec::new();
    for group in [&report.summary.all].into_iter().chain(&report.summary.groups) {
        let name = group.name.replace(' ', "-");
        for (acting, outcome) in group.outcomes() {
            scalars.push((format!("success-{acting}/{name}"), outcome.success.rate));
            scalars.extend(outcome.mean_steps_to_success.map(|n| (format!("steps-to-success-{acting}/{name}"), n)));
        }
    }
    for score in &report.blueprints {
        let tag = |acting| format!("{}-{acting}/{}", score.split, score.blueprint);
        scalars.extend(score.outcomes().map(|(acting, outcome)| (tag(acting), outcome.success.rate)));
    }
    scalars
}

#[cfg(test)]
mod tests {
    use proto::{ActionMode, WeightsVersion};

    use super::*;
    use crate::report::tests::episode;
    use crate::report::{End, summarize};

    #[test]
    fn rows_wait_until_the_history_can_be_written() {
        let dir = tempfile::tempdir().unwrap();
        let paths = RunPaths::new(dir.path());
        let mut records = Records::open(&paths).unwrap();
        let episode = episode("2_000", ActionMode::Greedy, End::Success { stable: true }, 9);
        let keep = |records: &mut Records, version| {
            let report = summarize(WeightsVersion(version), 100 * version, std::slice::from_ref(&episode));
            records.keep(&report, Evaluation::new(&report, version));
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
        let rows = History::read(&paths.history()).unwrap();
        assert_eq!(rows.iter().map(|row| row.n_env_steps).collect::<Vec<_>>(), [100, 200, 300]);
        let n_lines = || std::fs::read_to_string(paths.metrics()).unwrap().lines().count();
        assert_eq!(n_lines(), 6, "a summary and a blueprint for each evaluation");

        // Lines wait, too.
        let mut records = Records::open(&paths).unwrap();
        let aside = dir.path().join("aside");
        std::fs::rename(paths.metrics(), &aside).unwrap();
        std::fs::create_dir(paths.metrics()).unwrap();
        keep(&mut records, 4);
        keep(&mut records, 5);
        assert_eq!((records.unwritten.len(), records.waiting.len()), (2, 0));
        std::fs::remove_dir(paths.metrics()).unwrap();
        std::fs::rename(aside, paths.metrics()).unwrap();
        keep(&mut records, 6);
        assert_eq!((records.unwritten.len(), n_lines()), (0, 12));
    }
}

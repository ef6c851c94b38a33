//! Writes a running evaluator's reports to the run's folder.

use proto::metrics::{EvalOutcome, EvalReport};
use proto::{ActionMode, Role, keys};
use runlog::{History, Lines, MetricsWriter, Pass, RunPaths};

/// The open record files.
pub(crate) struct Records {
    metrics: MetricsWriter,
    history: History,
}

impl Records {
    /// Opens the record files. Opens the history first, so that a second writer is refused before anything is written.
    pub(crate) fn open(paths: &RunPaths) -> anyhow::Result<Self> {
        let history = History::open(&paths.history())?;
        Ok(Self { metrics: MetricsWriter::open(paths, Role::Evaluator)?, history })
    }

    /// Writes a report, whose history row is `row`, and returns the files.
    pub(crate) fn keep(mut self, report: &EvalReport, row: &Pass) -> anyhow::Result<Self> {
        self.metrics.append(&lines(report)?)?;
        self.history.append(row)?;
        self.metrics.scalars(report.summary.n_env_steps, scalars(report))?;
        Ok(self)
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

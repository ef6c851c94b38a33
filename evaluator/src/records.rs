//! The files in which a running evaluator keeps its reports.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;
use proto::keys;
use proto::metrics::EvalOutcome;
use proto::tensorboard::EventWriter;
use serde::Serialize;

use crate::history::{History, Pass};
use crate::report::{Acting, EvalReport};
use crate::run::RecordPaths;

/// Open files of records.
pub(crate) struct Records {
    metrics: PathBuf,
    history: History,
    tensorboard: EventWriter,
}

impl Records {
    /// Opens the history; the file of metrics is opened for each report, because others append to it.
    pub(crate) fn open(paths: &RecordPaths) -> anyhow::Result<Self> {
        let history = History::open(&paths.history)?;
        let tensorboard = EventWriter::create(&paths.tensorboard)
            .with_context(|| format!("writing to {}", paths.tensorboard.display()))?;
        Ok(Self { metrics: paths.metrics.clone(), history, tensorboard })
    }

    /// Keeps a report, which is `pass` in the history, and gives the files back.
    pub(crate) fn keep(mut self, report: &EvalReport, pass: &Pass) -> anyhow::Result<Self> {
        append(&self.metrics, report).with_context(|| format!("cannot write {}", self.metrics.display()))?;
        self.history.append(pass)?;
        self.tensorboard.scalars(report.summary.n_env_steps, scalars(report)).context("writing for TensorBoard")?;
        Ok(self)
    }
}

/// What TensorBoard is told: success and steps to success of every group, success of every blueprint, 0 to 1.
fn scalars(report: &EvalReport) -> Vec<(String, f64)> {
    let judged = |outcome: &EvalOutcome| outcome.success.n_episodes > 0;
    let mut scalars = Vec::new();
    for group in [&report.summary.all].into_iter().chain(&report.summary.groups) {
        for (acting, outcome) in [(Acting::Mode, &group.mode), (Acting::Sampled, &group.sampled)] {
            let (acting, group) = (acting.name(), group.name.replace(' ', "-"));
            if judged(outcome) {
                scalars.push((format!("success-{acting}/{group}"), outcome.success.rate));
            }
            scalars.extend(outcome.mean_steps_to_success.map(|n| (format!("steps-to-success-{acting}/{group}"), n)));
        }
    }
    for score in &report.blueprints {
        for (acting, outcome) in [(Acting::Mode, &score.mode), (Acting::Sampled, &score.sampled)] {
            if judged(outcome) {
                scalars.push((format!("{}-{}/{}", score.split, acting.name(), score.blueprint), outcome.success.rate));
            }
        }
    }
    scalars
}

/// A line of the metrics.
#[derive(Serialize)]
struct Line<'a, M> {
    /// Key of the metrics on the bus after `metrics/`.
    key: String,
    #[serde(flatten)]
    metrics: &'a M,
}

/// Appends a line for the summary and one for each blueprint, in one write because others append to the same file.
fn append(path: &Path, report: &EvalReport) -> anyhow::Result<()> {
    let mut lines = String::new();
    let mut push = |line: String| {
        lines.push_str(&line);
        lines.push('\n');
    };
    let key = keys::METRICS_EVAL_SUMMARY.to_owned();
    push(serde_json::to_string(&Line { key, metrics: &report.summary })?);
    for score in &report.blueprints {
        let key = keys::metrics_eval(score.split, &score.blueprint);
        push(serde_json::to_string(&Line { key, metrics: score })?);
    }
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)?;
    }
    let mut file = OpenOptions::new().create(true).append(true).open(path)?;
    file.write_all(lines.as_bytes())?;
    Ok(())
}

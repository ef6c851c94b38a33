//! The files in which a running evaluator keeps its reports.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;
use proto::keys;
use serde::Serialize;

use crate::history::{History, Pass};
use crate::report::EvalReport;
use crate::run::RecordPaths;

/// Open files of records.
pub(crate) struct Records {
    metrics: PathBuf,
    history: History,
}

impl Records {
    /// Opens the history; the file of metrics is opened for each report, because others append to it.
    pub(crate) fn open(paths: &RecordPaths) -> anyhow::Result<Self> {
        Ok(Self { metrics: paths.metrics.clone(), history: History::open(&paths.history)? })
    }

    /// Keeps a report, which is `pass` in the history, and gives the files back.
    pub(crate) fn keep(mut self, report: &EvalReport, pass: &Pass) -> anyhow::Result<Self> {
        append(&self.metrics, report).with_context(|| format!("cannot write {}", self.metrics.display()))?;
        self.history.append(pass)?;
        Ok(self)
    }
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

//! What `train` shows while it works: metrics that cross the bus, as lines or as a progress bar, and evaluations.

mod lines;
mod terminal;

use std::sync::Arc;
use std::time::Duration;

use bus::{AliveWatch, MetricsSubscriber};
use evaluator::{Detail, render};
use proto::metrics::EvalReport;
use proto::metrics::LearnerMetrics;
use tokio::sync::watch;
use tokio::time::Instant;

pub use terminal::{HeldLog, Terminal};

/// Least time between two lines where there is no terminal, so that a log stays readable.
const LINE_PERIOD: Duration = Duration::from_secs(10);

/// Shows the learner's metrics until the bus is closed, at most one line every ten seconds where there is no terminal.
///
/// `n_env_steps` is where the run ends, in environment steps.
pub async fn show_learning(mut metrics: MetricsSubscriber, actors: AliveWatch, terminal: Terminal, n_env_steps: u64) {
    let progress = terminal.progress(n_env_steps);
    let actors = actors.watch();
    let mut last_line: Option<Instant> = None;
    while let Some(sample) = metrics.recv().await {
        let learner: LearnerMetrics = match serde_json::from_value(sample.value) {
            Ok(learner) => learner,
            Err(error) => {
                tracing::debug!(%error, key = sample.suffix, "metrics of another version");
                continue;
            }
        };
        let n_actors = actors.borrow().len();
        progress.set(learner.n_env_steps, &lines::rates(&learner, n_actors));
        if !progress.is_drawn() && last_line.is_none_or(|shown| shown.elapsed() >= LINE_PERIOD) {
            last_line = Some(Instant::now());
            terminal.print(&lines::learner(&learner, n_actors, n_env_steps));
        }
    }
    progress.finish();
}

/// Prints a table of each report until the evaluator ends.
pub async fn show_reports(mut reports: watch::Receiver<Option<Arc<EvalReport>>>, terminal: Terminal) {
    while reports.changed().await.is_ok() {
        let report = reports.borrow_and_update().clone();
        if let Some(report) = report {
            terminal.print(&format!("\n{}", render(&report, Detail::Blueprints)));
        }
    }
}

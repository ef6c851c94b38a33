//! Progress output of commands: metrics of this process, as lines or as a progress bar, and evaluation reports.

mod episodes;
mod lines;
mod terminal;

use std::sync::Arc;
use std::time::Duration;

use bus::AliveWatch;
use dashboard::success_rate;
use evaluator::{Detail, EvaluationProgress, render};
use proto::metrics::{ActorMetrics, EvalReport, LearnerMetrics};
use tokio::sync::watch;
use tokio::time::Instant;

use crate::config::Config;
pub use episodes::EpisodeCounter;
use lines::{Context, Pace};
use terminal::Progress;
pub(crate) use terminal::has_colors;
pub use terminal::{HeldLog, Terminal};

/// Minimum time between two lines without a terminal, so that logs stay readable.
const LINE_PERIOD: Duration = Duration::from_secs(10);

/// Evaluation reports as they arrive.
pub type Reports = watch::Receiver<Option<Arc<EvalReport>>>;

/// How much of a report is printed.
pub fn detail(verbose: bool) -> Detail {
    /// Number of worst blueprints to list.
    const N_WORST: usize = 5;
    if verbose { Detail::Blueprints } else { Detail::Worst(N_WORST) }
}

/// Shows the metrics of this process's learner until it ends; without a terminal, at most one line every ten seconds.
pub async fn show_learning(
    mut metrics: watch::Receiver<Option<LearnerMetrics>>,
    actors: AliveWatch,
    reports: Reports,
    terminal: Terminal,
    config: &Config,
) {
    let progress = terminal.progress(config.n_env_steps, "steps");
    let actors = actors.watch();
    let mut context = Context { n_env_steps: config.n_env_steps, ..Context::default() };
    let mut pace = Pace::default();
    let mut last_line: Option<Instant> = None;
    let mut not_saved = None;
    while metrics.changed().await.is_ok() {
        let Some(learner) = metrics.borrow_and_update().clone() else { continue };
        context.sizes.add(&learner);
        context.n_actors = actors.borrow().len();
        context.left_s = pace.left_s(&learner, context.n_env_steps);
        let evaluated = reports.borrow().clone();
        context.evaluated = evaluated.and_then(|of| success_rate(&of.summary.all.greedy, &of.summary.all.sampled));
        progress.set(learner.n_env_steps, &lines::parts(&learner, &context).join("\n"));
        // There may be no other metrics for a long time.
        let is_urgent = learner.not_saved != not_saved;
        if !progress.is_drawn() && (is_urgent || last_line.is_none_or(|shown| shown.elapsed() >= LINE_PERIOD)) {
            last_line = Some(Instant::now());
            terminal.print(&lines::learner(&learner, &context));
        }
        not_saved = learner.not_saved;
    }
}

/// Prints the progress of this process's actor, at most one line every ten seconds, until it ends.
pub async fn show_acting(mut metrics: watch::Receiver<Option<ActorMetrics>>, terminal: Terminal) {
    let mut last_line: Option<Instant> = None;
    while metrics.changed().await.is_ok() {
        let Some(actor) = metrics.borrow_and_update().clone() else { continue };
        if last_line.is_none_or(|shown| shown.elapsed() >= LINE_PERIOD) {
            last_line = Some(Instant::now());
            terminal.print(&lines::actor(&actor));
        }
    }
}

/// Shows the progress of evaluations as a bar on a terminal; otherwise prints a line every ten seconds while
/// `prints_lines`.
pub async fn show_evaluating(
    mut progress: watch::Receiver<Option<EvaluationProgress>>,
    terminal: Terminal,
    prints_lines: impl Fn() -> bool,
) {
    let mut shown: Option<(Progress, Instant)> = None;
    let mut last_line = Instant::now();
    while progress.changed().await.is_ok() {
        let Some(EvaluationProgress { n_ended, n_planned }) = *progress.borrow_and_update() else {
            shown = None;
            continue;
        };
        let (bar, begun) = shown.get_or_insert_with(|| {
            last_line = Instant::now();
            (terminal.progress(n_planned, "episodes of the evaluation"), Instant::now())
        });
        // Before the first episode has ended, there is no pace to extrapolate.
        let left = if n_ended == 0 { String::new() } else { lines::left(n_ended, n_planned, begun.elapsed()) };
        bar.set(n_ended, &left);
        if !bar.is_drawn() && prints_lines() && last_line.elapsed() >= LINE_PERIOD {
            last_line = Instant::now();
            terminal.print(&format!("evaluating: {n_ended} of {n_planned} episodes  {left}"));
        }
    }
}

/// Prints a table of each report until the evaluator ends.
pub async fn show_reports(mut reports: Reports, terminal: Terminal, detail: Detail) {
    while reports.changed().await.is_ok() {
        let Some(report) = reports.borrow_and_update().clone() else { continue };
        terminal.print(&format!("\n{}", render(&report, detail)));
    }
}

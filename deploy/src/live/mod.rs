//! Progress output of commands: metrics of this process, as lines or as a progress bar, and evaluation reports.

mod lines;
mod terminal;

use std::sync::Arc;
use std::time::Duration;

use bus::AliveWatch;
use dashboard::success_rate;
use evaluator::{EvaluationProgress, render};
use proto::metrics::{ActorMetrics, EvalReport, LearnerMetrics};
use tokio::sync::watch;
use tokio::time::Instant;

use lines::{Context, Pace};
use terminal::Progress;
pub(crate) use terminal::has_colors;
pub use terminal::{HeldLog, Terminal};

/// Minimum time between two lines without a terminal, so that logs stay readable.
const LINE_PERIOD: Duration = Duration::from_secs(10);

/// Evaluation reports as they arrive.
pub type Reports = watch::Receiver<Option<Arc<EvalReport>>>;

/// Shows the metrics of this process's learner, which has `n_env_steps` to go through, until it ends. Without a
/// terminal, prints at most one line every ten seconds.
pub async fn show_learning(
    mut metrics: watch::Receiver<Option<LearnerMetrics>>,
    actors: AliveWatch,
    reports: Reports,
    terminal: Terminal,
    n_env_steps: u64,
) {
    let progress = terminal.progress(n_env_steps, "steps");
    let actors = actors.watch();
    let mut context = Context { n_env_steps, ..Context::default() };
    let mut pace = Pace::default();
    let mut last_line: Option<Instant> = None;
    let mut not_saved = None;
    while metrics.changed().await.is_ok() {
        let Some(learner) = metrics.borrow_and_update().clone() else { continue };
        context.sizes.add(&learner);
        context.n_actors = actors.borrow().len();
        context.left_s = pace.left_s(&learner, n_env_steps);
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

/// Shows how many episodes were `done`, such as "evaluated", as a bar on a terminal; otherwise prints a line every ten
/// seconds while `prints_lines`.
pub async fn show_episodes(
    mut progress: watch::Receiver<Option<EvaluationProgress>>,
    done: &str,
    terminal: Terminal,
    prints_lines: impl Fn() -> bool,
) {
    let mut shown: Option<(Progress, Instant)> = None;
    let mut last_line = Instant::now();
    while progress.changed().await.is_ok() {
        let Some(now) = *progress.borrow_and_update() else {
            shown = None;
            continue;
        };
        let (bar, begun) = shown.get_or_insert_with(|| {
            last_line = Instant::now();
            (terminal.progress(now.n_planned, &format!("episodes {done}")), Instant::now())
        });
        let so_far = lines::so_far(&now, begun.elapsed());
        bar.set(now.n_ended, &so_far);
        if !bar.is_drawn() && prints_lines() && last_line.elapsed() >= LINE_PERIOD {
            last_line = Instant::now();
            terminal.print(&format!("{} of {} episodes {done}  {so_far}", now.n_ended, now.n_planned));
        }
    }
}

/// Prints a table of each report until the evaluator ends.
pub async fn show_reports(mut reports: Reports, terminal: Terminal, verbose: bool) {
    while reports.changed().await.is_ok() {
        let Some(report) = reports.borrow_and_update().clone() else { continue };
        terminal.print(&format!("\n{}", render(&report, verbose)));
    }
}

//! Success by group, and the worst and best blueprints.

use std::time::Duration;

use proto::metrics::{EvalBlueprint, EvalGroup, EvalSummary};
use ratatui::text::Line;

use super::controls::Order;
use super::format::{age, count, name, success};
use super::styled::{columns, heading, plain};
use crate::run_view::{RunView, success_rate};

/// Names of the columns of [`success()`] by action mode.
const GREEDY: &str = "        greedy (95 %)";
const SAMPLED: &str = " sampled (95 %)";

/// Formats the newest evaluation in lines of `width` characters.
pub(super) fn lines(run: &RunView, now: Duration, width: usize) -> Vec<Line<'static>> {
    let Some(heard) = &run.evaluation else { return vec![heading("Success: no evaluation so far".to_owned())] };
    let summary = &heard.value;
    let version = summary.weights_version.0;
    let n_env_steps = count(summary.n_env_steps);
    let evaluated = age(now, heard.at);
    let title = match n_so_far(summary) {
        None => format!("Success in %: weights {version}, {n_env_steps} environment steps, evaluated {evaluated}"),
        Some(n) => {
            let n_planned = summary.n_planned;
            format!("Success in % so far, {n} of {n_planned} episodes: weights {version}, {n_env_steps} steps")
        }
    };
    let mut lines = vec![
        heading(title),
        columns(format!("  {:<14}  {GREEDY:<23} {:>6}  {SAMPLED:<23} {:>6}", "group", "of", "of")),
    ];
    lines.extend(summary.groups.iter().chain([&summary.all]).map(group));
    lines.extend(extremes(&run.evaluated_blueprints(), summary, width));
    lines
}

/// Returns the number of episodes of an evaluation that is not complete.
fn n_so_far(summary: &EvalSummary) -> Option<u64> {
    let outcomes = [&summary.all.greedy.success, &summary.all.sampled.success];
    (!summary.is_complete).then(|| outcomes.iter().map(|success| success.n_episodes).sum())
}

fn group(group: &EvalGroup) -> Line<'static> {
    let [greedy, sampled] = [&group.greedy.success, &group.sampled.success];
    let [n_greedy, n_sampled] = [greedy, sampled].map(|success| success.n_episodes);
    let (name, greedy, sampled) = (name(&group.name), success(greedy), success(sampled));
    plain(format!("  {name:<14}  {greedy:<23} {n_greedy:>6}  {sampled:<23} {n_sampled:>6}"))
}

/// Lists all blueprints of the newest evaluation: heading and column names, and the rows in this order.
pub(super) fn table(run: &RunView, now: Duration, order: Order) -> (Vec<Line<'static>>, Vec<Line<'static>>) {
    let mut blueprints = run.evaluated_blueprints();
    let evaluated = run.evaluation.as_ref().map_or_else(String::new, |heard| {
        let version = heard.value.weights_version.0;
        match n_so_far(&heard.value) {
            None => format!(": weights {version}, evaluated {}", age(now, heard.at)),
            Some(n) => format!(" so far, {n} of {} episodes: weights {version}", heard.value.n_planned),
        }
    });
    // Blueprints without episodes sort last.
    let rate = |of: &EvalBlueprint| success_rate(&of.greedy, &of.sampled).unwrap_or(f64::INFINITY);
    blueprints.sort_by(|a, b| {
        let by = match order.by {
            0 => rate(a).total_cmp(&rate(b)),
            1 => std::cmp::Ordering::Equal,
            _ => a.n_blocks.cmp(&b.n_blocks),
        };
        by.then_with(|| a.blueprint.cmp(&b.blueprint))
    });
    if order.is_reversed {
        blueprints.reverse();
    }
    let row = |blueprint: &&EvalBlueprint| {
        let [greedy, sampled] = [&blueprint.greedy.success, &blueprint.sampled.success];
        let [n_greedy, n_sampled] = [greedy, sampled].map(|success| success.n_episodes);
        let (id, greedy, sampled) = (name(blueprint.blueprint.as_str()), success(greedy), success(sampled));
        let n_blocks = blueprint.n_blocks;
        plain(format!("  {id:<16} {n_blocks:>6} {greedy:<22} {n_greedy:>3} {sampled:<22} {n_sampled:>3}"))
    };
    let heads = columns(format!("  {:<16} blocks {GREEDY:<22} {:>3} {SAMPLED:<22} {:>3}", "blueprint", "of", "of"));
    let title = heading(format!("Success by blueprint in %{evaluated}"));
    (vec![title, heads], blueprints.iter().map(row).collect())
}

/// Lists the worst and the best blueprints with greedy actions, or with sampled actions if no greedy episodes were run.
/// Each line lists as many as fit. No blueprint is in both lines, and the best have at least one success.
fn extremes(blueprints: &[&EvalBlueprint], summary: &EvalSummary, width: usize) -> Vec<Line<'static>> {
    let rate = |of: &&EvalBlueprint| success_rate(&of.greedy, &of.sampled);
    let mut ranked: Vec<(f64, &str)> =
        blueprints.iter().filter_map(|of| Some((rate(of)?, of.blueprint.as_str()))).collect();
    ranked.sort_by(|left, right| left.0.total_cmp(&right.0).then(left.1.cmp(right.1)));
    let n_worst = ranked.len().div_ceil(2);
    let (worst, best) = ranked.split_at(n_worst);
    let way = if summary.all.greedy.success.n_episodes > 0 { "" } else { " sampled" };
    let mut lines = Vec::new();
    if !worst.is_empty() {
        lines.push(plain(row(&format!("  worst{way}"), worst.iter(), width)));
    }
    let mut best = best.iter().rev().filter(|(rate, _)| *rate > 0.0).peekable();
    if best.peek().is_some() {
        lines.push(plain(row(&format!("  best{way} "), best, width)));
    }
    lines
}

fn row<'a>(title: &str, ranked: impl Iterator<Item = &'a (f64, &'a str)>, width: usize) -> String {
    let mut text = title.to_owned();
    for (rate, id) in ranked {
        let entry = format!("  {} {:.1}", name(id), 100.0 * rate);
        if text.len() + entry.len() > width {
            break;
        }
        text += &entry;
    }
    text
}

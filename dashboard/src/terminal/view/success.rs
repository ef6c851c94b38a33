//! Success by group, and the worst and best blueprints.

use std::time::Duration;

use proto::metrics::{EvalBlueprint, EvalGroup, EvalSummary};
use proto::wilson::SuccessRate;
use ratatui::text::Line;

use super::format::{age, count, name, success};
use super::{columns, heading, plain};
use crate::run_view::RunView;

/// The newest evaluation in lines of `width` characters.
pub(super) fn lines(run: &RunView, now: Duration, width: usize) -> Vec<Line<'static>> {
    let Some(heard) = run.evaluation() else {
        return vec![heading("Success: no evaluation so far".to_owned())];
    };
    let summary = &heard.value;
    let (version, n_env_steps) = (summary.weights_version.0, count(summary.n_env_steps));
    let judged = age(now, heard.at);
    let mut lines = vec![
        heading(format!("Success in %: weights {version}, {n_env_steps} environment steps, evaluated {judged}")),
        columns(format!(
            "  {:<12}  {:<23} {:>6}  {:<23} {:>6}",
            "group", " mode (95 % interval)", "of", " sampled (95 %)", "of"
        )),
    ];
    lines.extend(summary.groups.iter().chain([&summary.all]).map(group));
    lines.extend(extremes(&run.judged_blueprints(), summary, width));
    lines
}

fn group(group: &EvalGroup) -> Line<'static> {
    let (mode, sampled) = (&group.mode.success, &group.sampled.success);
    plain(format!(
        "  {:<12}  {:<23} {:>6}  {:<23} {:>6}",
        name(&group.name),
        success(mode),
        mode.n_episodes,
        success(sampled),
        sampled.n_episodes,
    ))
}

/// The worst and the best blueprints with mode actions, or with sampled ones where only those were judged: as many as fit
/// in a line, none in both.
fn extremes(blueprints: &[&EvalBlueprint], summary: &EvalSummary, width: usize) -> Vec<Line<'static>> {
    let is_mode = summary.all.mode.success.n_episodes > 0;
    let rate = |blueprint: &EvalBlueprint| -> SuccessRate {
        if is_mode { blueprint.mode.success } else { blueprint.sampled.success }
    };
    let mut ranked: Vec<(f64, &str)> = blueprints
        .iter()
        .filter(|blueprint| rate(blueprint).n_episodes > 0)
        .map(|blueprint| (rate(blueprint).rate, blueprint.blueprint.as_str()))
        .collect();
    ranked.sort_by(|left, right| left.0.total_cmp(&right.0).then(left.1.cmp(right.1)));
    let n_worst = ranked.len().div_ceil(2);
    let (worst, best) = ranked.split_at(n_worst);
    let way = if is_mode { "" } else { " sampled" };
    let mut lines = Vec::new();
    if !worst.is_empty() {
        lines.push(plain(row(&format!("  worst{way}"), worst.iter(), width)));
    }
    if !best.is_empty() {
        lines.push(plain(row(&format!("  best{way} "), best.iter().rev(), width)));
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

//! The roster: who steps worlds, how fast, and who is lost.

use std::time::Duration;

use proto::ActorId;
use ratatui::text::Line;

use super::drops::total;
use super::format::{age, count, rate};
use super::{alarm, columns, heading, plain};
use crate::run_view::{Actor, Link, RunView};

/// Width of an actor's name, characters.
const NAME_WIDTH: usize = 20;

/// Heading, columns and as many actors as fit into `height` lines: those alive before those lost.
pub(super) fn lines(run: &RunView, now: Duration, height: usize) -> Vec<Line<'static>> {
    let (alive, lost): (Vec<_>, Vec<_>) = run.actors().iter().partition(|(_, actor)| actor.is_alive);
    let steps_per_s: f64 =
        alive.iter().filter_map(|(_, actor)| actor.metrics.as_ref()).map(|heard| heard.value.env_steps_per_s).sum();
    let title = match run.link().0 {
        Link::Lost => "Actors: unknown while the router is gone".to_owned(),
        _ => format!("Actors: {} alive, {} lost; {} steps/s", alive.len(), lost.len(), rate(steps_per_s)),
    };
    let mut lines = vec![if lost.is_empty() { heading(title) } else { alarm(title) }];
    if alive.is_empty() && lost.is_empty() {
        return lines;
    }
    lines.push(columns(format!(
        "  {:<NAME_WIDTH$} {:<5} {:>8} {:>8} {:>4} {:>9} {:>8}  heard",
        "actor", "", "steps/s", "weights", "lag", "accepted", "dropped"
    )));
    let rows: Vec<_> = alive.into_iter().chain(lost).collect();
    let n_fit = height.saturating_sub(lines.len());
    let n_shown = if rows.len() > n_fit { n_fit.saturating_sub(1) } else { rows.len() };
    lines.extend(rows.iter().take(n_shown).map(|(id, actor)| row(id, actor, now)));
    if n_shown < rows.len() {
        lines.push(plain(format!("  and {} more", rows.len() - n_shown)));
    }
    lines
}

fn row(id: &ActorId, actor: &Actor, now: Duration) -> Line<'static> {
    let mut id = id.to_string();
    if id.len() > NAME_WIDTH {
        id.truncate(NAME_WIDTH - 1);
        id.push('~');
    }
    let state = if actor.is_alive { "alive" } else { "lost" };
    let text = match &actor.metrics {
        None => format!("  {id:<NAME_WIDTH$} {state:<5} has said nothing so far"),
        Some(heard) => {
            let metrics = &heard.value;
            let n_dropped = total(&metrics.dropped);
            format!(
                "  {id:<NAME_WIDTH$} {state:<5} {:>8} {:>8} {:>4} {:>9} {:>8}  {}{}",
                rate(metrics.env_steps_per_s),
                metrics.weights_version.0,
                metrics.policy_lag,
                count(metrics.n_trajectories_acked),
                count(n_dropped),
                age(now, heard.at),
                if metrics.learner_is_there { "" } else { ", sees no learner" },
            )
        }
    };
    if actor.is_alive { plain(text) } else { alarm(text) }
}

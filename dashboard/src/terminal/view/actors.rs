//! The actor table: which actors are alive, their throughput, and which are lost.

use std::time::Duration;

use proto::ActorId;
use proto::metrics::ActorMetrics;
use ratatui::text::Line;

use super::controls::Order;
use super::drops::total;
use super::format::{age, count, rate};
use super::styled::{alarm, columns, heading, plain};
use crate::run_view::{Link, Newest, RunView};

/// Width of an actor's name in characters.
const NAME_WIDTH: usize = 20;

/// An actor's newest metrics, if any.
type Heard<'r> = Option<&'r Newest<ActorMetrics>>;

/// Returns the heading, column names and as many actors as fit into `height` lines, live actors before lost ones.
pub(super) fn lines(run: &RunView, now: Duration, height: usize) -> Vec<Line<'static>> {
    let (mut lines, rows) = table(run, now, Order::default());
    if rows.is_empty() {
        // No rows: omit the column names.
        lines.truncate(1);
        return lines;
    }
    let n_fit = height.saturating_sub(lines.len());
    let n_rows = rows.len();
    let is_cut = n_rows > n_fit;
    let n_shown = if is_cut { n_fit.saturating_sub(1) } else { n_rows };
    lines.extend(rows.into_iter().take(n_shown));
    if is_cut {
        lines.push(plain(format!("  and {} more", n_rows - n_shown)));
    }
    lines
}

/// Returns the heading and column names, and the rows of all actors in this order, live actors before lost ones.
pub(super) fn table(run: &RunView, now: Duration, order: Order) -> (Vec<Line<'static>>, Vec<Line<'static>>) {
    let mut rows: Vec<(&ActorId, Heard<'_>)> = run.actors.iter().map(|(id, heard)| (id, heard.as_ref())).collect();
    // Actors without metrics come last; the largest number comes first.
    let number = |heard: Heard<'_>| -> f64 {
        let Some(heard) = heard else { return f64::NEG_INFINITY };
        match order.by {
            1 => heard.value.env_steps_per_s,
            2 => heard.value.policy_lag as f64,
            _ => total(&heard.value.dropped) as f64,
        }
    };
    if order.by > 0 {
        rows.sort_by(|a, b| number(b.1).total_cmp(&number(a.1)));
    }
    if order.is_reversed {
        rows.reverse();
    }
    let (alive, lost): (Vec<_>, Vec<_>) = rows.into_iter().partition(|(id, _)| run.is_alive(id));
    let steps_per_s: f64 = alive.iter().filter_map(|(_, heard)| *heard).map(|heard| heard.value.env_steps_per_s).sum();
    let title = match run.link {
        Link::Lost => "Actors: unknown while the router is gone".to_owned(),
        _ => format!("Actors: {} alive, {} lost; {} steps/s", alive.len(), lost.len(), rate(steps_per_s)),
    };
    let title = if lost.is_empty() { heading(title) } else { alarm(title) };
    let heads = columns(format!(
        "  {:<NAME_WIDTH$} {:<5} {:>8} {:>8} {:>4} {:>9} {:>8}  heard",
        "actor", "", "steps/s", "weights", "lag", "accepted", "dropped"
    ));
    let rows = alive.into_iter().chain(lost).map(|(id, heard)| row(id, heard, run.is_alive(id), now)).collect();
    (vec![title, heads], rows)
}

fn row(id: &ActorId, heard: Heard<'_>, is_alive: bool, now: Duration) -> Line<'static> {
    let mut id = id.to_string();
    if id.len() > NAME_WIDTH {
        id.truncate(NAME_WIDTH - 1);
        id.push('~');
    }
    let state = if is_alive { "alive" } else { "lost" };
    let text = match heard {
        None => format!("  {id:<NAME_WIDTH$} {state:<5} has said nothing so far"),
        Some(heard) => {
            let metrics = &heard.value;
            format!(
                "  {id:<NAME_WIDTH$} {state:<5} {:>8} {:>8} {:>4} {:>9} {:>8}  {}{}",
                rate(metrics.env_steps_per_s),
                metrics.weights_version.0,
                metrics.policy_lag,
                count(metrics.n_trajectories_acked),
                count(total(&metrics.dropped)),
                age(now, heard.at),
                if metrics.learner_is_there { "" } else { ", sees no learner" },
            )
        }
    };
    if is_alive { plain(text) } else { alarm(text) }
}

//! Header: the watched run and the age of its data.

use std::time::Duration;

use bus::BusConfig;
use ratatui::text::Line;

use super::format::{age, span};
use super::styled::{alarm, heading, plain};
use crate::run_view::{Link, RunView, waits};

/// Returns two lines, a third if the learner cannot save, and one with the other runs on the router if this run is empty.
pub(super) fn lines(run: &RunView, config: &BusConfig, now: Duration) -> Vec<Line<'static>> {
    let title = heading(format!("Run {} at {}", config.run, config.connect.join(", ")));
    let mut lines = vec![title, state(run, now)];
    lines.extend(run.learner.as_ref().and_then(|heard| heard.value.not_saved.as_ref()).map(|why| alarm(waits(why))));
    if run.is_empty() && !run.others.is_empty() {
        let names: Vec<&str> = run.others.iter().map(String::as_str).collect();
        lines.push(plain(format!("Runs on this router: {}; --run NAME watches one", names.join(", "))));
    }
    lines
}

fn state(run: &RunView, now: Duration) -> Line<'static> {
    let since = span(now.saturating_sub(run.link_since));
    let learner = run.learner.as_ref().map(|heard| heard.at);
    let evaluation = run.evaluation.as_ref().map(|heard| heard.at);
    let (n_learners, n_evaluators) = (run.roster.learners.len(), run.roster.evaluators.len());
    let members = [member("learner", n_learners, learner, now), member("evaluator", n_evaluators, evaluation, now)];
    match run.link {
        Link::Joining => alarm(format!("No router was reached in {since}; still trying")),
        Link::Lost => {
            let newest = learner
                .max(evaluation)
                .map_or("nothing came before".to_owned(), |at| format!("the newest came {}", age(now, at)));
            alarm(format!("The router has been gone for {since}; {newest}"))
        }
        Link::Connected if run.is_empty() => {
            alarm(format!("Nothing has arrived in {since}: no learner, evaluator or actor has joined this run"))
        }
        Link::Connected if n_learners == 0 => alarm(members.join(", ")),
        Link::Connected => plain(members.join(", ")),
    }
}

/// Describes whether a service is alive and how long ago its last message arrived.
fn member(role: &str, n_alive: usize, heard_at: Option<Duration>, now: Duration) -> String {
    match (n_alive, heard_at) {
        (0, None) => format!("no {role}"),
        (0, Some(at)) => format!("{role} gone, heard {}", age(now, at)),
        (1, None) => format!("{role} silent so far"),
        (1, Some(at)) => format!("{role} heard {}", age(now, at)),
        (n, None) => format!("{n} {role}s silent so far"),
        (n, Some(at)) => format!("{n} {role}s heard {}", age(now, at)),
    }
}

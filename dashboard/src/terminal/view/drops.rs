//! Everything that was dropped, by counting process and reason.

use std::collections::BTreeMap;

use proto::metrics::{IngestCounts, VideoCounts};
use ratatui::text::Line;
use serde::Serialize;

use super::format::count;
use super::styled::{heading, plain};
use crate::run_view::{RunView, counters};

/// Counters of trajectories that the learner received but did not drop.
const NOT_DROPPED: [&str; 3] = ["received_total", "accepted_total", "duplicates_total"];

/// Returns all nonzero drop counters, under their names on the page, in lines of `width` characters.
pub(super) fn lines(run: &RunView, width: usize) -> Vec<Line<'static>> {
    let mut drops = Drops::default();
    if let Some(learner) = run.learner.as_ref().map(|heard| &heard.value) {
        drops.add("learner", "expired", learner.expired_total);
        drops.add("learner", "not usable", learner.unmade_total);
        drops.add("learner", "updates taken back", learner.refused_total);
        drops.add("learner", "gradient steps skipped", learner.ppo.n_skipped_steps);
        // Refused segments are sent again; `back_pressure` shows them separately.
        drops.add_all("learner", &IngestCounts { full_total: 0, ..learner.ingest });
        drops.add_all("learner's bus", &learner.bus);
    }
    for actor in run.actors.values().flatten() {
        drops.add_all("actors", &actor.value.dropped);
        drops.add_all("actors' bus", &actor.value.bus);
    }
    if let Some(evaluation) = run.evaluation.as_ref().map(|heard| &heard.value) {
        let all = &evaluation.all;
        drops.add("evaluator", "diverged", all.greedy.n_diverged.saturating_add(all.sampled.n_diverged));
        drops.add_all("evaluator's bus", &evaluation.bus);
        if let Some(videos) = evaluation.videos {
            drops.add_all("videos", &VideoCounts { written_total: 0, n_waiting: 0, ..videos });
        }
    }
    drops.add_all("watch", &run.unread);
    drops.add_all("watch's bus", &run.bus);
    let mut lines = drops.lines(width);
    // Segments that arrived while the mailbox was full: actors wait and send them again.
    let n_refused = run.learner.as_ref().map(|heard| heard.value.ingest.full_total).filter(|n| *n > 0);
    let said = |n| plain(format!("  back-pressure {}: came while the mailbox was full, sent again", count(n)));
    lines.extend(n_refused.map(said));
    lines
}

/// Returns the sum of all counters in a struct.
pub(super) fn total(counts: &impl Serialize) -> u64 {
    counters(counts).into_iter().fold(0, |sum, (_, n)| sum.saturating_add(n))
}

#[derive(Default)]
struct Drops(BTreeMap<String, u64>);

impl Drops {
    fn add(&mut self, who: &str, reason: &str, n: u64) {
        if n > 0 {
            let sum = self.0.entry(format!("{who}: {reason}")).or_default();
            *sum = sum.saturating_add(n);
        }
    }

    fn add_all(&mut self, who: &str, counts: &impl Serialize) {
        for (name, n) in counters(counts) {
            if !NOT_DROPPED.contains(&name.as_str()) {
                self.add(who, &name.trim_end_matches("_total").replace('_', " "), n);
            }
        }
    }

    fn lines(&self, width: usize) -> Vec<Line<'static>> {
        if self.0.is_empty() {
            return vec![heading("Dropped: nothing".to_owned())];
        }
        let mut lines = vec![heading("Dropped".to_owned())];
        let mut text = String::from(" ");
        for (name, n) in &self.0 {
            let entry = format!(" {name} {}", count(*n));
            if text.len() > 1 && text.len() + entry.len() > width {
                lines.push(plain(std::mem::replace(&mut text, String::from(" "))));
            }
            text += &entry;
            text.push(' ');
        }
        lines.push(plain(text));
        lines
    }
}

//! A run as lines: on a screen of any size, or as plain text.

mod actors;
mod drops;
mod format;
mod header;
mod success;
mod training;

use std::time::Duration;

use ratatui::Frame;
use ratatui::style::Style;
use ratatui::text::{Line, Text};

use crate::run_view::RunView;

/// Width of plain text, characters.
const TEXT_WIDTH: usize = 100;

/// Lines that the drops may take on a screen while actors want room too.
const DROPS_HEIGHT: usize = 3;

/// Least lines of the actors' section: its heading, the columns and one actor.
const ACTORS_HEIGHT: usize = 3;

/// What is watched, as the command line named it.
#[derive(Clone, Debug)]
pub(crate) struct Source {
    /// Name of the run.
    pub(crate) run: String,
    /// Endpoints of the router.
    pub(crate) endpoints: Vec<String>,
}

/// Draws what is known `now`, the time since the watch began. What does not fit is cut off, at the end first.
pub(crate) fn draw(frame: &mut Frame<'_>, run: &RunView, source: &Source, now: Duration) {
    let area = frame.area();
    let lines = page(run, source, now, area.width.into(), area.height.into());
    frame.render_widget(Text::from(lines), area);
}

/// All that is known `now`, the time since the watch began, as plain text.
pub(crate) fn text(run: &RunView, source: &Source, now: Duration) -> String {
    let sections = [
        header::lines(run, source, now),
        success::lines(run, now, TEXT_WIDTH),
        training::lines(run),
        actors::lines(run, now, usize::MAX),
        drops::lines(run, TEXT_WIDTH),
    ];
    let lines = sections.iter().flatten().map(|line| line.to_string().trim_end().to_owned());
    lines.collect::<Vec<_>>().join("\n")
}

/// The sections one below the other; the actors' takes what the others leave.
fn page(run: &RunView, source: &Source, now: Duration, width: usize, height: usize) -> Vec<Line<'static>> {
    let mut lines = header::lines(run, source, now);
    lines.extend(success::lines(run, now, width));
    lines.extend(training::lines(run));
    let mut drops = drops::lines(run, width);
    let rest = height.saturating_sub(lines.len());
    if drops.len() > rest.saturating_sub(ACTORS_HEIGHT) && drops.len() > DROPS_HEIGHT {
        let n_left_out = drops.len() - (DROPS_HEIGHT - 1);
        drops.truncate(DROPS_HEIGHT - 1);
        drops.push(plain(format!("  and {n_left_out} more lines")));
    }
    lines.extend(actors::lines(run, now, rest.saturating_sub(drops.len())));
    lines.extend(drops);
    lines.truncate(height);
    lines
}

fn plain(text: String) -> Line<'static> {
    Line::from(text)
}

fn heading(text: String) -> Line<'static> {
    Line::styled(text, Style::new().bold())
}

fn columns(text: String) -> Line<'static> {
    Line::styled(text, Style::new().dim())
}

fn alarm(text: String) -> Line<'static> {
    Line::styled(text, Style::new().red().bold())
}

#[cfg(test)]
mod tests;

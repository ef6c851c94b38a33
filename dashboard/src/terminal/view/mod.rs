//! Formats a run as lines, for a screen of any size or as plain text.

mod actors;
mod controls;
mod drops;
mod format;
mod header;
mod styled;
mod success;
mod training;
mod trends;

use std::time::Duration;

use bus::BusConfig;
use ratatui::Frame;
use ratatui::text::{Line, Text};

use crate::run_view::RunView;

pub(crate) use controls::{Controls, ends};
pub use format::seconds;

use controls::Part;
use styled::plain;

/// Width of plain text in characters.
const TEXT_WIDTH: usize = 80;

/// Maximum height of the drops section on a screen where the actors need room.
const DROPS_HEIGHT: usize = 3;

/// Minimum height of the actors section: heading, column names and one actor.
const ACTORS_HEIGHT: usize = 3;

/// Minimum screen height for which the footer is drawn.
const FOOTER_FROM: usize = 8;

/// Draws the selected part of the state as of `now`, the time since the watch began. Rows that do not fit can be
/// scrolled to.
pub(crate) fn draw(frame: &mut Frame<'_>, run: &RunView, config: &BusConfig, controls: &mut Controls, now: Duration) {
    let area = frame.area();
    let (width, height) = (usize::from(area.width), usize::from(area.height));
    let mut lines = header::lines(run, config, now);
    let has_footer = height >= FOOTER_FROM;
    let mut room = height.saturating_sub(lines.len() + usize::from(has_footer));
    let (fixed, rows) = match controls.part() {
        None => (Vec::new(), controls::help()),
        Some(Part::Overview) => (Vec::new(), overview(run, now, width, room)),
        Some(Part::Blueprints) => success::table(run, now, controls.order()),
        Some(Part::Actors) => actors::table(run, now, controls.order()),
        Some(Part::Learning) => trends::lines(run, width),
    };
    room = room.saturating_sub(fixed.len());
    let n_rows = rows.len();
    lines.extend(fixed);
    let mut shown = controls.visible(rows, room);
    if has_footer {
        shown.resize(room, Line::default());
        shown.push(controls.footer(n_rows));
    }
    lines.extend(shown);
    frame.render_widget(Text::from(lines), area);
}

/// Formats the full known state as of `now`, the time since the watch began, as plain text.
pub(crate) fn text(run: &RunView, config: &BusConfig, now: Duration) -> String {
    let sections = [
        header::lines(run, config, now),
        success::lines(run, now, TEXT_WIDTH),
        training::lines(run, TEXT_WIDTH),
        actors::lines(run, now, usize::MAX),
        drops::lines(run, TEXT_WIDTH),
    ];
    let lines = sections.iter().flatten().map(|line| line.to_string().trim_end().to_owned());
    lines.collect::<Vec<_>>().join("\n")
}

/// Stacks all sections; the actors section gets the height that the others leave.
fn overview(run: &RunView, now: Duration, width: usize, height: usize) -> Vec<Line<'static>> {
    let mut lines = success::lines(run, now, width);
    lines.extend(training::lines(run, width));
    let mut drops = drops::lines(run, width);
    let rest = height.saturating_sub(lines.len());
    if drops.len() > rest.saturating_sub(ACTORS_HEIGHT) && drops.len() > DROPS_HEIGHT {
        let n_left_out = drops.len() - (DROPS_HEIGHT - 1);
        drops.truncate(DROPS_HEIGHT - 1);
        drops.push(plain(format!("  and {n_left_out} more lines")));
    }
    lines.extend(actors::lines(run, now, rest.saturating_sub(drops.len())));
    lines.extend(drops);
    lines
}

#[cfg(test)]
mod tests;

//! Lines of one style.

use blueprints::outside::printable;
use ratatui::style::Style;
use ratatui::text::Line;

/// Names in messages can be anything.
fn shown(text: String) -> String {
    printable(&text).into_owned()
}

pub(super) fn plain(text: String) -> Line<'static> {
    Line::from(shown(text))
}

pub(super) fn heading(text: String) -> Line<'static> {
    Line::styled(shown(text), Style::new().bold())
}

pub(super) fn columns(text: String) -> Line<'static> {
    Line::styled(shown(text), Style::new().dim())
}

pub(super) fn alarm(text: String) -> Line<'static> {
    Line::styled(shown(text), Style::new().red().bold())
}

//! Metrics over time as sparklines.

use ratatui::text::Line;

use super::format::number;
use super::styled::{columns, heading, plain};
use crate::run_view::RunView;

/// Bars, lowest to highest.
const BARS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];

/// Width of a metric's name in characters.
const NAME_WIDTH: usize = 21;

/// Minimum number of bars per sparkline in the overview; with less room, the line is omitted.
const MIN_BARS: usize = 6;

/// Metrics with a sparkline in the overview.
const OVERVIEW: [&str; 2] = ["success, evaluated", "steps per second"];

/// Lists all tracked metrics: newest value, range and sparkline.
pub(super) fn lines(run: &RunView, width: usize) -> (Vec<Line<'static>>, Vec<Line<'static>>) {
    let before = format!("  {:<NAME_WIDTH$} {:>9} {:>9} {:>9}  ", "", "now", "least", "most");
    let room = width.saturating_sub(before.len());
    let rows = run.trends().map(|(name, values)| {
        let (least, most) = range(&values);
        let now = values.last().copied().unwrap_or_default();
        let [now, least, most] = [now, least, most].map(number);
        plain(format!("  {name:<NAME_WIDTH$} {now:>9} {least:>9} {most:>9}  {}", bars(&values, room)))
    });
    let rows: Vec<Line<'static>> = rows.collect();
    let title = if rows.is_empty() { "Learning: nothing so far" } else { "Learning, since this watch began" };
    (vec![heading(title.to_owned()), columns(before + "newest on the right")], rows)
}

/// Formats the main metrics in one line of `width` characters; `None` until one of them has two values.
pub(super) fn overview(run: &RunView, width: usize) -> Option<Line<'static>> {
    let trends: Vec<_> = run.trends().filter(|(name, values)| OVERVIEW.contains(name) && values.len() > 1).collect();
    let title = "  trend      ";
    let names: usize = trends.iter().map(|(name, _)| name.len() + 3).sum();
    let each = width.saturating_sub(title.len() + names) / trends.len().max(1);
    if trends.is_empty() || each < MIN_BARS {
        return None;
    }
    let parts = trends.iter().map(|(name, values)| format!(" {name} {}", bars(values, each)));
    Some(plain(title.to_owned() + &parts.collect::<Vec<_>>().join(" ")))
}

/// Draws the newest values as at most `width` bars.
fn bars(values: &[f64], width: usize) -> String {
    let (least, most) = range(values);
    let bar = |value: f64| {
        let share = if most > least { (value - least) / (most - least) } else { 0.0 };
        BARS[((share * BARS.len() as f64) as usize).min(BARS.len() - 1)]
    };
    values.iter().skip(values.len().saturating_sub(width)).map(|value| bar(*value)).collect()
}

fn range(values: &[f64]) -> (f64, f64) {
    values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), value| (least.min(*value), most.max(*value)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bars_rise_from_the_least_value_to_the_most() {
        let values = [0.0, 1.0, 3.9, 8.0, 4.0];
        assert_eq!(bars(&values, 10), "▁▂▄█▅");
        assert_eq!(bars(&values, 2), "█▅");
        assert_eq!(bars(&[5.0, 5.0], 10), "▁▁");
        assert_eq!(bars(&[], 10), "");
    }
}
